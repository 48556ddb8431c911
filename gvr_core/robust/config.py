"""The switches and settings of ``gvr-robust``: one switch for each weak place that it mends."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

from gvr_core import paper

NEGATIVES = ("object", "things", "stuff", "texture")
"""Canonical phrases that a patch must be less like than the query.
Source: Kerr et al., "LERF: Language Embedded Radiance Fields" (ICCV 2023)."""


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class RobustIndex(_Part):
    """What is worked out once for a scene."""

    ground_up: bool = True
    """The up direction follows the ground plane; off: the mean of the cameras' up axes."""
    floaters: bool = True
    """Gaussians that hang alone in the air, or are nearly invisible or huge, are left out of the
    virtual views; off: everything is drawn."""


class RobustLocate(_Part):
    """(B) Retrieval for localising."""

    canonical_negatives: bool = True
    """Relevancy against canonical phrases, where the encoder's space has a use for them; off:
    against the scene's typical patch."""
    multi_level_masks: bool = True
    """Patches of every granularity; off: the coarsest of each view."""
    several_patches: bool = True
    """All patches of a view that pass the gate; off: the best one of every view, forced."""
    median_depth: bool = True
    """The median depth over the eroded patch; off: the expected depth at the patch's position."""
    density_clusters: bool = True
    """Density clustering at the object's own scale; off: the paper's vote and mean."""
    all_instances: bool = True
    """Every instance with enough behind it; off: the strongest one."""
    stuff: bool = True
    """Areas (a lawn, a wall) are lifted from the views; off: they are taken for things."""
    refusal: bool = True
    """Too little evidence is answered with "not here"; off: something is always answered."""
    phrases: bool | None = None
    """Whether the encoder's space has a use for canonical phrases; None for what was calibrated."""
    temperature: float = Field(default=10.0, gt=0)
    """Of the softmax between query and negative phrase, as in LERF."""
    gate: float = Field(default=0.5, ge=0, lt=1)
    """A patch is a candidate where its relevancy is above this: where it is more like the query
    than like every canonical phrase."""
    gate_share: float = Field(default=0.5, ge=0, le=1)
    """And where it rises above 0.5 by this part of what the scene's best patch does, at least."""
    refuse_below: float | None = Field(default=None, ge=0, le=1)
    """Least confidence to answer; None for what was calibrated for the encoder."""
    min_views: int = Field(default=2, ge=1)
    """Least number of views that must agree."""
    cluster_radii: float = Field(default=1.0, gt=0)
    """Candidates are neighbours within so many (median) object radii."""
    min_share: float = Field(default=0.05, ge=0, le=1)
    """A cluster's core has at least this share of the candidates around it, and at least 3."""
    instance_share: float = Field(default=0.5, gt=0, le=1)
    """A further instance has at least this part of the strongest one's weight."""
    max_instances: int = Field(default=8, ge=1)
    """At most so many instances."""
    stuff_share: float = Field(default=0.3, gt=0, le=1)
    """What covers more than this part of the views that show it is an area."""
    vote_radius: float = Field(default=paper.VOTE_RADIUS_FRACTION, gt=0)
    """Without density clusters: the voting radius as a fraction of the viewing distance."""


class RobustSegment(_Part):
    """(C) Online segmentation."""

    bev_clip: bool = True
    """What is higher than the object is left out of the bird's-eye view."""
    bev_gate: bool = True
    """A bird's-eye view of what no camera has seen from above is not trusted: the retrieved
    views' own masks are lifted in its place."""
    weight_filter: bool = True
    """A Gaussian is judged by what it contributes inside and outside of a mask; off: by whether
    its centre projects into it."""
    soft_vote: bool = True
    """Views vote by what they see, and one without a detection abstains; off: intersection."""
    retrieved_views: bool = True
    """The views that retrieved the object vote too, with their own patches; off: only the ring."""
    ring_fit: bool = True
    """The ring stands as far away as it must for the whole object to be in the picture; off: at
    the paper's distance, centred at L_3D."""
    cleanup: bool = True
    """Gaussians that no view has seen follow their neighbours, and strays are dropped."""
    ring_views: int = Field(default=paper.RING_VIEWS_K, ge=1)
    """k: number of ring cameras."""
    ring_distance: float = Field(default=paper.RING_DISTANCE_FACTOR, gt=0)
    """d_vir in widths of the coarse target, at least."""
    ring_pitch: float = Field(default=paper.RING_PITCH_DEGREES, gt=-90, lt=90)
    """Pitch of the ring cameras, degrees."""
    bev_distance: float = Field(default=paper.BEV_DISTANCE_FACTOR, gt=0)
    """Height of the bird's-eye camera, in mean distances of the knowledge cameras."""
    clip_margin: float = Field(default=0.5, ge=0)
    """The bird's-eye view is clipped this many object radii above the object's radius."""
    observed_share: float = Field(default=0.5, ge=0, le=1)
    """Part of the bird's-eye mask that at least two cameras must have seen from above."""
    observed_degrees: float = Field(default=60.0, gt=0, lt=180)
    """How far from straight above such a camera may be."""
    keep_at: float = Field(default=0.5, gt=0, lt=1)
    """Least share of a Gaussian's votes that say it is the object."""
    agree_iou: float = Field(default=0.2, ge=0, le=1)
    """A ring detection that overlaps less than this with what is drawn counts as none."""
    vote_views: int = Field(default=16, ge=1)
    """At most so many retrieved views vote, spread over the directions."""
    neighbours: int = Field(default=16, ge=1)
    """How many neighbours decide for a Gaussian that no view has seen."""


class RobustConfig(RobustIndex, RobustLocate, RobustSegment):
    """All of them, flat: ``robust = { bev_clip = false }`` in a suite."""

    @classmethod
    def switch_names(cls) -> tuple[str, ...]:
        """The parts that can be left out, in the order in which the method comes to them."""
        parts = (RobustIndex, RobustLocate, RobustSegment)
        return tuple(
            name
            for part in parts
            for name, info in part.model_fields.items()
            if info.annotation is bool
        )

    def switches(self) -> tuple[str, ...]:
        """The parts that are on."""
        return tuple(name for name in self.switch_names() if getattr(self, name))
