"""Evaluation protocols by id; one file for each family."""

from __future__ import annotations

from gvr_core.errors import unknown_name
from gvr_core.protocols.base import ProtocolSpec
from gvr_core.protocols.lerf_mask import GG, GG_COMPAT
from gvr_core.protocols.lerf_ovs import LANGSPLAT_2D, OPENGAUSSIAN_3D
from gvr_core.protocols.ovs3d import BINARY, EXCLUSIVE
from gvr_core.protocols.own import OWN_FLAGS_3D, OWN_IN_SCENE_2D, OWN_REFUSAL

PROTOCOLS: dict[str, ProtocolSpec] = {
    spec.id: spec
    for spec in (
        OWN_IN_SCENE_2D,
        OWN_FLAGS_3D,
        OWN_REFUSAL,
        LANGSPLAT_2D,
        OPENGAUSSIAN_3D,
        GG,
        GG_COMPAT,
        BINARY,
        EXCLUSIVE,
    )
}
"""Id -> protocol, ours first."""


def protocol(name: str) -> ProtocolSpec:
    """The protocol of an id.

    Args:
        name: ``family.name/version``, or without ``/version`` for the newest.

    Raises:
        ConfigError: for an id that is not known, listing those that are.
    """
    if name in PROTOCOLS:
        return PROTOCOLS[name]
    versions = {
        int(version): known
        for known in PROTOCOLS
        for stem, _, version in [known.rpartition("/")]
        if stem == name
    }
    if not versions:
        raise unknown_name("protocol", name, PROTOCOLS)
    return PROTOCOLS[versions[max(versions)]]
