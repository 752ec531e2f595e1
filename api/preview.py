"""A page that shows what a cfg makes, and follows the file."""

from __future__ import annotations

import base64
import contextlib
import html
import io
import json
import re
import secrets
import shutil
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from scenec.api.declare import Spread
from scenec.api.options import PreviewOptions
from scenec.api.steps import AnyCfg, cache_folder, read_cfg
from scenec.datasets.view.site import Site, site_planes
from scenec.schemas.codec import JsonObject
from scenec.schemas.errors import CfgError, ScenecError
from scenec.schemas.files import Stamp, atomic, check_output, stamp
from scenec.schemas.scratch import scratch_folder

if TYPE_CHECKING:
    from scenec.backends.run.auto import Quickest
    from scenec.compiler.cfg.load import Spec
    from scenec.schemas.units import Executor

#: Seconds between two looks at the files, and that a browser's question may wait.
_LOOK_S, _WAIT_S = 0.25, 20.0
#: Samples of each camera that are drawn, first the first one.
_SAMPLES = 4
#: Cells of the map along its longer side.
_CELLS = 360
#: The same of what the ground is to a vehicle, looked at and shown.
_SITE_CELLS, _SITE_SHOWN = 640, 256
#: By these names alone the page is answered, and this is a version of its facts.
_OWN_HOST = re.compile(r"(127\.0\.0\.1|localhost)(:[0-9]{1,5})?", re.IGNORECASE)
_VERSION = re.compile("[0-9]{1,18}")


@dataclass(frozen=True)
class PreviewPage:
    """Holds a cfg's preview as one offline page of HTML; shows itself in a notebook.

    Attributes:
        content: The page, UTF-8.
    """

    content: bytes

    def save(self, path: Path | str) -> Path:
        """Writes it to a file, whose path is returned.

        Raises:
            OutputError: It cannot be written.
        """
        check_output(Path(path))
        with atomic(Path(path)) as temporary:
            temporary.write_bytes(self.content)
        return Path(path)

    def _repr_html_(self) -> str:
        text = html.escape(self.content.decode(), quote=True)
        return f'<iframe srcdoc="{text}" width="100%" height="600"></iframe>'


@Spread(PreviewOptions).one
def preview(cfg: AnyCfg, options: PreviewOptions) -> PreviewPage:
    """Shows what a cfg makes: a map, sketches, and pictures of the first batch.

    Args:
        cfg: As of ``compile``.
        options: As fields of ``PreviewOptions``.

    Raises:
        CfgError: The cfg has faults.
        ScenecError: The scene cannot be made.
    """
    # Before a renderer is sought, which takes seconds.
    spec = read_cfg(cfg, options.settings)
    with _previewing("cfg", options) as made:
        made.make(read_cfg(cfg, [*options.settings, *coarse(spec, options.width)]))
        return PreviewPage(page(made.state.facts(), live=False))


@contextlib.contextmanager
def live_preview(
    cfg: Path | str, options: PreviewOptions, *, port: int = 0
) -> Iterator[tuple[str, Preview]]:
    """Serves the page to this machine's own user; ``Preview.follow`` keeps it up to date.

    Args:
        cfg: The cfg's file.
        options: What is shown; its listener hears the faults of the cfg, as the page shows them.
        port: Of the page; 0 takes a free one.

    Raises:
        ScenecError: The port is taken.
    """
    with _previewing(str(cfg), options) as preview, _served(preview.state, port) as address:
        yield address, preview


@contextlib.contextmanager
def _previewing(cfg: str, options: PreviewOptions) -> Iterator[Preview]:
    from scenec.backends.run.executors import make_executor

    quick = how_to_draw(options)
    with scratch_folder() as folder, make_executor(1) as executor:
        yield Preview(cfg, options, quick, Path(folder), executor)


def how_to_draw(options: PreviewOptions) -> Quickest:
    """Completes what the options leave open of backend and samples, and says it in a line.

    Raises:
        BackendError: No renderer works here.
    """
    from scenec.backends.registry import AUTO
    from scenec.backends.run.auto import Quickest, quickest, works_here

    if options.backend == AUTO:
        quick = quickest(works_here)
        options.listener.say(f"preview: {quick.backend} draws: {quick.why}")
    else:
        quick = Quickest(options.backend, 8, False, "asked for")
    return quick if options.spp is None else replace(quick, spp=options.spp)


class PreviewState:
    """Holds the state of the page; changed by one thread, read by many."""

    def __init__(self) -> None:
        self._facts: dict[str, Any] = {"version": 0, "doing": "", "faults": [], "pictures": []}
        self._changed = threading.Condition()

    def set(self, **facts: Any) -> None:
        """Change some of it."""
        with self._changed:
            self._facts = {**self._facts, **facts, "version": self._facts["version"] + 1}
            self._changed.notify_all()

    def facts(self) -> JsonObject:
        """All of it."""
        return self._facts

    def after(self, version: int) -> JsonObject:
        """All of it, once it is another version, or after some time."""
        with self._changed:
            self._changed.wait_for(lambda: self._facts["version"] != version, _WAIT_S)
            return self._facts


class Preview:
    """Compiles coarsely and draws, again and again."""

    def __init__(
        self,
        cfg: str,
        options: PreviewOptions,
        quick: Quickest,
        folder: Path,
        executor: Executor,
    ) -> None:
        self.state = PreviewState()
        self._cfg, self._options, self._say = cfg, options, options.listener.say
        self._quick = quick
        self._folder, self._executor = folder, executor
        self._made, self._out = 0, folder / "0"
        self._files: tuple[str, ...] = (cfg,)

    def follow(self) -> None:
        """Make it, and make it again whenever a file has changed."""
        while True:
            seen = self._stamps()
            try:
                spec = self.load()
                seen = self._stamps()
                self.make(spec, lambda seen=seen: self._stamps() != seen)
            except CfgError as error:
                lines = [str(fault) for fault in error.faults]
                self.state.set(faults=lines, doing="")
                self._say("\n".join(lines))
            except ScenecError as error:
                self.state.set(faults=[str(error)], doing="")
                self._say(str(error))
            self._wait(seen)

    def load(self) -> Spec:
        """The cfg, with smaller pictures: meshes and levels of detail follow these.

        Raises:
            CfgError: It has faults.
        """
        from scenec.compiler.cfg import sources
        from scenec.compiler.cfg.load import load

        options = self._options
        self.state.set(doing=f"reading {self._cfg}")
        with contextlib.suppress(CfgError):
            read = sources.read(sources.located(Path(self._cfg)), options.settings)
            places = read.document.values.values()
            self._files = tuple(dict.fromkeys(p.file for p in places if p.line)) or self._files
        spec = load(self._cfg, options.settings)
        self._files += tuple(str(file.path) for file in spec.files.values())
        return load(self._cfg, [*options.settings, *coarse(spec, options.width)])

    def make(self, spec: Spec, stale: Any = lambda: False) -> None:
        """Compile the first batch, sketch it, draw it.

        Args:
            spec: The cfg.
            stale: Whether what is being made is out of date.

        Raises:
            ScenecError: It cannot be made.
        """
        from scenec.api.shown import StageView
        from scenec.api.site import site_of
        from scenec.backends.stage.ground import relief
        from scenec.compiler.compile import compile_cfg
        from scenec.schemas.manifest import find_batches

        put = self.state.set
        # Path tracers denoise no picture with an aperture.
        rigs = spec.cfg["rigs"].values()
        if any("focus" in sensor for rig in rigs for sensor in rig["sensors"].values()):
            self._quick = replace(self._quick, denoise=False)
        # Workers may still hold what lay in the last one.
        shutil.rmtree(self._out, ignore_errors=True)
        self._made += 1
        self._out = self._folder / str(self._made)
        put(doing="compiling", faults=[str(fault) for fault in spec.warnings])
        started = time.perf_counter()
        compile_cfg(
            spec,
            seed=self._options.seed,
            out=self._out,
            cache=cache_folder(self._options.cache),
            replace=True,
            progress=lambda text, place: put(doing=text) if place else None,
        )
        took = f"compiled in {time.perf_counter() - started:.1f} s"
        stage = StageView(find_batches(self._out, [0])[0])
        _, _, heights = relief(stage.scene, _CELLS)
        facts = {"map": _png(shaded(heights)), "made": took}
        cameras = [camera.name for camera in stage.cameras]
        sketches = [
            {"name": name, "sample": 0, "sketch": True, "png": _png(stage.sketch(i))}
            for i, name in enumerate(cameras)
        ]
        put(pictures=sketches, doing=f"drawing with {self._quick.backend}", **facts)
        put(site=_site_facts(site_of(stage.scene, _SITE_CELLS, stage.caster)))
        drawn: list[dict[str, Any]] = []
        for sample in _spread(len(stage.scene.cameras)):
            if stale():
                return
            drawn += self._drawn(sample)
            done = {picture["name"] for picture in drawn}
            put(pictures=[*drawn, *(one for one in sketches if one["name"] not in done)])
        put(doing="", made=f"{took}, all drawn in {time.perf_counter() - started:.1f} s")

    def _drawn(self, sample: int) -> list[dict[str, Any]]:
        """Pictures of all cameras at a sample."""
        from scenec.backends.run.render import render

        quick = self._quick
        report = render(
            self._out, quick.backend, samples=[sample], spp=quick.spp, denoise=quick.denoise,
            passes=("rgb",), executor=self._executor,
        )  # fmt: skip
        if report.failed:
            raise ScenecError("; ".join(report.failed))
        return [
            {
                "name": stem.parent.name,
                "sample": sample,
                "png": base64.b64encode(stem.with_suffix(".png").read_bytes()).decode(),
            }
            for stem in report.frames
            if stem.name == f"{sample:06d}"
        ]

    def _wait(self, before: list[Stamp | None]) -> None:
        """Wait until files change, and rest: some editors empty one before they write it."""
        now = last = before
        while now == before or now != last:
            time.sleep(_LOOK_S)
            now, last = self._stamps(), now

    def _stamps(self) -> list[Stamp | None]:
        """Returns stamps by which changes of files are noticed; None for a missing file."""
        stamps: list[Stamp | None] = []
        for name in self._files:
            try:
                stamps.append(stamp(Path(name)))
            except OSError:
                stamps.append(None)
        return stamps


def coarse(spec: Spec, width: int) -> list[str]:
    """Settings that make a cfg quick: one batch, pictures of at most this width.

    Cameras whose intrinsics are given keep their size.
    """
    settings = ["batches=1"]
    for rig, node in spec.cfg["rigs"].items():
        for name, sensor in node["sensors"].items():
            across, down = sensor["resolution"]
            if across > width and sensor["intrinsics"] is None:
                size = [width, max(1, round(down * width / across))]
                settings.append(f"rigs.{rig}.sensors.{name}.resolution={json.dumps(size)}")
    return settings


def shaded(heights: NDArray[np.floating]) -> NDArray[np.uint8]:
    """A map of heights, lit from the northwest, north up: uint8 [h, w, 3]."""
    filled = np.nan_to_num(heights, nan=float(np.nanmean(heights)))
    north, east = np.gradient(filled)
    steep = 2.0 / max(1e-12, float(np.percentile(np.hypot(north, east), 95)))
    light = (0.7 + steep * (east - north) * 0.3) / np.sqrt(
        1.0 + (steep * np.hypot(north, east)) ** 2
    )
    low, high = filled.min(), filled.max()
    tone = (filled - low) / max(high - low, 1e-12)
    color = np.stack([0.55 + 0.35 * tone, 0.5 + 0.35 * tone, 0.42 + 0.3 * tone], axis=-1)
    picture = np.clip(color * (0.35 + 0.75 * light[..., None]), 0.0, 1.0)
    return np.round(255.0 * picture[::-1]).astype(np.uint8)


def page(facts: JsonObject, *, live: bool) -> bytes:
    """The page, with what it shows first.

    Args:
        facts: Of ``PreviewState``.
        live: Whether it goes on asking.
    """
    text = (resources.files("scenec.api") / "preview.html").read_text(encoding="utf-8")
    first = json.dumps({**facts, "live": live}).replace("<", "\\u003c")
    script = resources.files("scenec.datasets.view") / "browser" / "site.js"
    text = text.replace("/* site.js */", script.read_text(encoding="utf-8"))
    return text.replace("%FIRST%", first).encode()


@contextlib.contextmanager
def _served(state: PreviewState, port: int) -> Iterator[str]:
    """Serves the page to who knows its address: this machine's own user.

    The address holds a token, so that neither another user of the machine nor a page of another
    site can guess it. A name that somebody else lets point to this machine (DNS rebinding) is not
    answered either.
    """
    token = secrets.token_urlsafe(16)

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            path, _, query = self.path.partition("?")
            given, slash, rest = path.removeprefix("/").partition("/")
            host = self.headers.get("Host", "")
            if _OWN_HOST.fullmatch(host) is None:
                self.send_error(403, "the page answers to 127.0.0.1 and localhost")
            elif not secrets.compare_digest(given.encode(), token.encode()):
                self.send_error(403, "the address that the command printed has a token")
            elif slash and not rest:
                self._answer("text/html; charset=utf-8", page(state.facts(), live=True))
            elif rest == "state" and _VERSION.fullmatch(query):
                facts = json.dumps(state.after(int(query))).encode()
                self._answer("application/json", facts)
            else:
                self.send_error(404)

        def _answer(self, kind: str, content: bytes) -> None:
            # A browser that turns away is no fault.
            with contextlib.suppress(ConnectionError):
                self.send_response(200)
                self.send_header("Content-Type", kind)
                self.send_header("Content-Length", str(len(content)))
                self.send_header("Cache-Control", "no-store")
                self.end_headers()
                self.wfile.write(content)

        def log_message(self, format: str, *args: Any) -> None:
            """Nothing: the terminal is for the cfg."""

    try:
        server = ThreadingHTTPServer(("127.0.0.1", port), Handler)
    except OSError as error:
        raise ScenecError(f"--port {port}: {error.strerror}; take another one") from error
    server.daemon_threads = True
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_port}/{token}/"
    finally:
        server.shutdown()


def _spread(samples: int) -> Sequence[int]:
    """Some samples, evenly spread, the first one first."""
    count = min(samples, _SAMPLES)
    return [i * samples // count for i in range(count)]


def _site_facts(site: Site | None) -> JsonObject | None:
    """What the page needs of a site."""
    if site is None:
        return None
    facts, codes = site_planes(site, _SITE_SHOWN, heights=True)
    return {**facts, "codes": base64.b64encode(codes).decode()}


def _png(pixels: NDArray[np.uint8]) -> str:
    from PIL import Image

    data = io.BytesIO()
    Image.fromarray(pixels).save(data, "PNG")
    return base64.b64encode(data.getvalue()).decode()
