"""Layout files: what stands where, and from where it is seen (TOML).

`docs/stress_scenes.md` lists the keys; the tables are in `datasets.layout_objects` (labelled
things), `datasets.layout_room` (everything around them) and `datasets.layout_cameras`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, ClassVar

from pydantic import Field, ValidationError

from datasets.layout_cameras import CamerasTable, WorldTable
from datasets.layout_objects import AnyObject, PhotographTable, SplatTable
from datasets.layout_room import FloatersTable, GroundTable, SurfaceTable
from datasets.layout_tables import Table, Text
from datasets.native_records import check_distinct, check_name, validation_error
from gvr_core.errors import DatasetError
from gvr_core.untrusted import read_toml


class AbsentTable(Table):
    """``[[absent]]``: a query for something that is not there."""

    text: Text


class Layout(Table):
    """A whole layout file."""

    ADDED_LATER: ClassVar[tuple[str, ...]] = ("surfaces", "floaters", "world", "states_up")

    objects: Annotated[tuple[AnyObject, ...], Field(min_length=1)]
    ground: GroundTable
    surfaces: tuple[SurfaceTable, ...] = ()
    floaters: FloatersTable | None = None
    cameras: CamerasTable
    world: WorldTable | None = None
    absent: tuple[AbsentTable, ...] = ()
    states_up: bool = True
    """Whether the scene says where up is. Scenes from COLMAP do not: methods have to find out."""
    licence: Text
    """Whose splats they are, and how they may be used."""

    def splats(self) -> tuple[str, ...]:
        """Names of the splat files it needs, each once."""
        return tuple(
            dict.fromkeys(item.file for item in self.objects if isinstance(item, SplatTable))
        )

    def photographs(self) -> tuple[str, ...]:
        """Names of the photographs it shows, each once."""
        return tuple(
            dict.fromkeys(
                item.photograph for item in self.objects if isinstance(item, PhotographTable)
            )
        )


def read_layout(path: Path) -> Layout:
    """A layout file, checked.

    Raises:
        DatasetError: naming the line that is no TOML, or the key that is unknown or wrong.
    """
    try:
        content = read_toml(path)
    except ValueError as error:
        raise DatasetError(f"not TOML: {error}", path=path) from error
    except OSError as error:
        raise DatasetError(f"cannot be read: {error.strerror}", path=path) from error
    try:
        layout = Layout.model_validate(content)
    except ValidationError as error:
        raise validation_error(error, path) from error
    for index, item in enumerate(layout.objects):
        check_name(item.name, "object", path, f"objects[{index}].name")
    check_distinct([item.name for item in layout.objects], "object", path, "objects")
    return layout
