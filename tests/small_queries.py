"""Questions about the small scene of two boxes, and what they mean."""

from __future__ import annotations

from small_scene import OBJECTS

from gvr_core.scene import Query

QUERIES = (
    Query(id="red-1", text="a red box", target=OBJECTS[0]),
    Query(id="red-2", text="the crimson cube", target=OBJECTS[0]),
    Query(id="blue-1", text="a blue box", target=OBJECTS[1]),
    Query(id="absent-1", text="an elephant", absent=True),
)
MEANINGS = {query.text: query.target for query in QUERIES if query.target}
