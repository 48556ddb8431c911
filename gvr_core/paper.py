"""The constants of the paper, each in this one place, with its symbol.

Source: "Zero-Shot Visual Grounding in 3D Gaussians via View Retrieval" (GVR). Where the paper
gives no value, the constant is marked *reading*: our choice, with its reason.
"""

from __future__ import annotations

RING_VIEWS_K = 4
"""k: number of surrounding (ring) cameras in the online segmentation."""

RING_DISTANCE_FACTOR = 3.0
"""d_vir / w_tar: distance of a ring camera from L_3D, in widths of the coarse target."""

RING_PITCH_DEGREES = 30.0
"""Pitch of the ring cameras above the horizontal plane through L_3D, in degrees."""

FEATURE_DIM_C = 512
"""c: length of a semantic vector in the paper (CLIP ViT-B-16). Other encoders have their own."""

TOP_K_VIEWS = None
"""*Reading*: every view votes. An integer keeps only the views whose best patch scores highest."""

VOTE_RADIUS_FRACTION = 0.1
"""*Reading*: two views agree when their points lie within this fraction of the distance from
which the views look (the median over views). The paper compares Euclidean distances and names
no scale; a fraction of the viewing distance does not depend on the scene's units."""

BEV_DISTANCE_FACTOR = 1.0
"""*Reading*: height of the bird's-eye camera above L_3D, in mean distances from the knowledge
cameras to L_3D: the object is then about as large in the bird's-eye view as in the views."""

WIDTH_PERCENTILE = 90.0
"""*Reading*: w_tar is twice this percentile of the coarse Gaussians' horizontal distances from
their median; the maximum would follow a single floater."""

PREPARATION_SECONDS = 37.0
"""Time to prepare a scene that the paper reports, on one RTX 4090."""
