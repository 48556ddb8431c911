"""The viewer: a scene in the browser, and questions asked of it there."""

from __future__ import annotations

import html
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from flows.view_drawing import EVIDENCE, SHOWN, Drawing
from flows.view_session import Asked, ViewSession
from gvr_core.errors import ConfigError, GVRError
from gvr_core.exports import EXPORTS, write_dyed, write_target, write_without
from reports.addresses import check_address, free_port

_WRITERS: dict[str, Callable[..., None]] = {
    "target": write_target,
    "without": write_without,
    "dyed": write_dyed,
}


class Viewer:
    """Serves one scene to browsers until it is stopped.

    Args:
        session: Answers the questions.
        port: TCP port; 0 takes any free one.
        host: Address to listen at.
        exposed: Let it be one that other machines reach.
        source: What saved PLYs copy their rows from: the scene's own file; its Gaussians where
            None.

    Raises:
        ConfigError: for an address or port that cannot be used, or where viser is missing.
    """

    def __init__(
        self,
        session: ViewSession,
        port: int = 8080,
        host: str = "127.0.0.1",
        exposed: bool = False,
        source: Path | None = None,
    ) -> None:
        check_address(host, exposed)
        port = free_port(host, port)
        self._session = session
        self._source = source or session.data.scene.gaussians
        self._asked: Asked | None = None
        self._one_at_a_time = threading.Lock()
        self._server = _viser().ViserServer(host, port, label="GVR-Bench", verbose=False)
        self.url = f"http://{host}:{self._server.get_port()}"
        """Where the page is."""
        self._build_page()
        self._drawing = Drawing(self._server, session.data.scene)

    def stop(self) -> None:
        """End the server."""
        self._server.stop()

    def wait(self) -> None:
        """Serve until the process is interrupted."""
        self._server.sleep_forever()

    def ask(self, text: str) -> None:
        """Answer a text and draw the answer; what is wrong with it is said on the page.

        Args:
            text: What to look for.
        """
        with self._one_at_a_time:
            self._say("Looking …")
            try:
                asked = self._session.ask(text)
            except GVRError as error:
                self._say(html.escape(str(error)), alert=True)
                return
            self._asked = asked
            self._drawing.draw(asked.grounding, self._shown.value, self._ticked())
            self._say(_answer(asked))

    def _build_page(self) -> None:
        gui, scene = self._server.gui, self._session.data.scene
        gui.configure_theme(show_logo=False, show_share_button=False)
        gui.main_panel.dock_right()
        name = html.escape(f"{scene.dataset}/{scene.name}")
        gui.add_html(
            f'<div style="padding:0.5em 1em 0"><b>{name}</b><br>{len(scene.gaussians):,} Gaussians'
            f" · {len(scene.views)} views · {html.escape(self._session.method.name)}</div>"
        )
        with gui.add_form(None) as form:
            text = gui.add_text("Find", "", hint="What is looked for, in words")
            find = gui.add_button("Find")
        self._status = gui.add_html("")
        self._say("Type what to find, and press Enter.")
        self._shown = gui.add_dropdown("Target", SHOWN, hint="How the target is shown")
        with gui.add_folder("Evidence"):
            self._boxes = {
                name: gui.add_checkbox(name.capitalize(), name == "location") for name in EVIDENCE
            }
        with gui.add_folder("Save"):
            kind = gui.add_dropdown("PLY", tuple(EXPORTS), hint="What the file holds")
            save = gui.add_button("Save")
        find.on_click(lambda event: self.ask(text.value))
        form.on_submit(lambda event: self.ask(text.value))
        self._shown.on_update(lambda event: self._drawing.show_target(self._shown.value))
        for box in self._boxes.values():
            box.on_update(lambda event: self._drawing.show_evidence(self._ticked()))
        save.on_click(lambda event: self._save(kind.value, event.client))

    def _ticked(self) -> set[str]:
        return {name for name, box in self._boxes.items() if box.value}

    def _say(self, line: str, alert: bool = False) -> None:
        """Put a line of HTML under the question."""
        colour = "color:#d62728" if alert else ""
        self._status.content = (
            f'<div id="gvr-status" role="status" style="padding:0 1em;{colour}">{line}</div>'
        )

    def _save(self, kind: str, client: Any) -> None:
        """Send a PLY to the browser that asked for it."""
        if self._asked is None or client is None:
            self._say("Nothing has been found yet that could be saved.", alert=True)
            return
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "export.ply"
            try:
                _WRITERS[kind](path, self._source, self._asked.grounding.flags)
            except GVRError as error:
                self._say(html.escape(str(error).replace(f"{path}: ", "")), alert=True)
                return
            client.send_file_download(f"{kind}.ply", path.read_bytes(), save_immediately=True)


def _answer(asked: Asked) -> str:
    """An answer in a line of HTML; words that a user typed are not repeated in it."""
    grounding = asked.grounding
    count, n = int(grounding.flags.sum()), len(grounding.flags)
    dyed = f'<b id="gvr-count">{count:,}</b> of {n:,} Gaussians'
    said = dyed if grounding.found else f"Not here, it says ({dyed} flagged)"
    return f"{said} · confidence {grounding.confidence:.2f} · {asked.seconds:.1f} s"


def _viser() -> Any:
    try:
        import viser
    except ImportError as error:
        raise ConfigError(
            "the viewer needs viser, which is not installed",
            accepted="pip install 'gvr-bench[viewer]' -c constraints.txt",
        ) from error
    return viser
