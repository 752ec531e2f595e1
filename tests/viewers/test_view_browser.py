"""The page of ``scenec view`` in a real browser, opened from disk, without a network."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from browser import canvas_pixels, open_browser, opened_page

from scenec.datasets.colors import label_colors, paint_depth, paint_instances, viridis
from scenec.datasets.view.ground import Ground
from scenec.datasets.view.page import write_view
from scenec.datasets.view.site import Site
from scenec.schemas.frames import frame_stem, read_frame
from scenec.schemas.georeference import Georeference
from scenec.schemas.manifest import Batch
from scenec.schemas.vehicle import TRAVERSABILITY, Vehicle
from scenec.testing import made_output

pytestmark = pytest.mark.slow
WIDTH, HEIGHT = 96, 64


def scene(number: int) -> made_output.Passes:
    """Blocks of rocks on a plane that recedes; normals, too."""
    passes = made_output.some_passes(number, WIDTH, HEIGHT)
    y = np.mgrid[0:HEIGHT, 0:WIDTH][0].astype(np.float32)
    passes["depth"] = np.where(np.isfinite(passes["depth"]), 80 - y + passes["depth"] / 9, np.inf)
    passes["depth"] = passes["depth"].astype(np.float32)
    passes["normal"] = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    passes["normal"][HEIGHT // 4 :] = (0.6, 0.0, 0.8)
    return passes


#: On Mars's ellipsoid, over the date line, the axes leaning from east and north.
PLACE = Georeference(
    "Mars", 3396190.0, 3376200.0, -71.5, 179.99999, (0.8, 0.6, -0.6, 0.8), "IAU_2015:49900"
)


def hill(batch: Batch) -> Ground:
    y, x = np.mgrid[-20:21, -30:31].astype(float)
    z = 3 * np.exp(-(x * x + y * y) / 200)
    # Twice as fine: slopes of 2 degrees a meter to the east, classes from the west to the east.
    x = 0.05 + 0.1 * np.arange(122) + np.zeros((82, 1))
    classes = np.minimum(x // 3.05, 3).astype(np.uint8)
    site = Site((-3.05, -4.05), 0.1, np.zeros(x.shape), 2 * x, classes, Vehicle(), PLACE)
    return Ground((-3.0, -4.0), (0.2, 0.2), z, ((30.0, 90.0),) * 3, site=site)


@pytest.fixture(scope="module")
def out(tmp_path_factory) -> Path:
    out = made_output.make_output(tmp_path_factory.mktemp("made") / "out", scene, samples=3)
    for batch in out.glob("batch_*/frames"):
        shutil.copytree(batch / "annotation", batch / "second")
        for path in batch.glob("second/*/*.json"):
            told = json.loads(path.read_bytes())
            told |= {"seconds": {"load": 0.5, "radiance": 2.0}}
            told |= {"estimated_error": {"relative_rms": 0.25}}
            path.write_text(json.dumps(told))
    broken = out / "batch_0001" / "frames" / "second" / "rover_right" / "000002.exr"
    broken.write_bytes(b"no EXR")
    return out


@pytest.fixture(scope="module")
def page_file(out, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("page") / "view.html"
    write_view(out, path, ground=hill)
    return path


@pytest.fixture(scope="module")
def chromium() -> Iterator:
    with open_browser() as browser:
        yield browser


@pytest.fixture
def page(chromium, page_file) -> Iterator:
    with opened_page(chromium, page_file) as found:
        yield found


def painted(page, pass_name: str) -> None:
    page.wait_for_selector(f'#sheet canvas[data-pass="{pass_name}"][data-done]')


def frame_at(out: Path, page) -> dict[str, np.ndarray]:
    batch, camera, sample = page.text_content(".where b").split(" / ")
    backend = page.text_content(".where span").split(" · ")[0]
    return read_frame(frame_stem(out / batch, backend, camera, int(sample))).passes


def open_layer(page, layer: str) -> None:
    page.click(f'#viewer-bar [data-pass="{layer}"]')
    page.wait_for_selector(f'#large[data-done$="/{layer}"]')


def test_every_frame_of_every_backend_has_a_tile(page):
    assert page.text_content("#counts") == "24 frames"
    assert page.get_attribute(".tile", "aria-setsize") == "24"
    assert page.text_content("#faults") == "1 faulty"
    page.focus("#grid")
    page.keyboard.press("End")
    page.wait_for_selector(".tile.faulty")
    assert "000002.exr" in page.text_content(".tile.faulty .fault")
    assert page.eval_on_selector(".tile.faulty", "t => t.querySelector('canvas')") is None


def test_each_layer_has_the_colors_of_the_contact_sheet(page, out):
    page.focus("#grid")
    page.keyboard.press("Enter")
    passes = frame_at(out, page)
    for level, names in made_output.LABELS.items():
        open_layer(page, f"label.{level}")
        colors = label_colors(list(names))
        shown = canvas_pixels(page, "#large")
        wanted = np.array([colors[i] for i in passes[f"label.{level}"].ravel().tolist()])
        assert (shown.reshape(-1, 3) == wanted).all()
    open_layer(page, "instance")
    difference = canvas_pixels(page, "#large").astype(int) - paint_instances(passes["instance"])
    assert np.abs(difference).max() <= 1
    open_layer(page, "depth")
    near, far = page.eval_on_selector_all(
        "#facts .ticks span", "all => [all[0], all.at(-1)].map(e => parseFloat(e.textContent))"
    )
    difference = canvas_pixels(page, "#large").astype(int) - paint_depth(passes["depth"], near, far)
    # The page looks colors up in a table of 256.
    assert np.abs(difference).max() <= 4
    assert np.ptp(viridis(np.linspace(0, 1, 9)).astype(int)) > 100
    open_layer(page, "normal")
    shown = canvas_pixels(page, "#large").astype(int)
    assert np.abs(shown[-1, -1] - 127.5 * (1 + np.array([0.6, 0.0, 0.8]))).max() <= 2
    assert (shown[0, 0] == 255).all()


def test_toggles_change_what_tiles_show(page):
    painted(page, "rgb")
    before = page.locator("#sheet canvas").count()
    page.click('[data-layer="label.class"]')
    painted(page, "label.class")
    names = page.eval_on_selector_all("#t0 canvas", "all => all.map(c => c.dataset.pass)")
    assert names == ["rgb", "label.class"]
    assert page.locator('#sheet canvas[data-pass="rgb"]').count() <= before
    rgb, label = (
        canvas_pixels(page, '#t0 [data-pass="rgb"]'),
        canvas_pixels(page, '#t0 [data-pass="label.class"]'),
    )
    assert len(np.unique(rgb.reshape(-1, 3), axis=0)) > 100
    assert len(np.unique(label.reshape(-1, 3), axis=0)) <= 3
    page.keyboard.press("1")
    assert page.eval_on_selector_all("#t0 canvas", "all => all.map(c => c.dataset.pass)") == [
        "label.class"
    ]
    page.keyboard.press("2")
    # What was the last one stays.
    assert page.locator("#t0 canvas").count() == 1


def test_hovering_tells_the_values_of_the_arrays_at_that_pixel(page, out):
    page.focus("#grid")
    page.keyboard.press("Enter")
    page.wait_for_selector("#large[data-done]:not([data-done=''])")
    page.wait_for_selector("#readout .hint")
    passes = frame_at(out, page)
    table = made_output.frame_table(passes)
    box = page.locator("#large").bounding_box()
    rng = np.random.default_rng(0)
    places = np.column_stack([rng.integers(0, HEIGHT, 12), rng.integers(0, WIDTH, 12)]).tolist()
    places += [np.argwhere(passes["instance"] == number)[0].tolist() for number in table["id"]]
    places += [[0, 0], [HEIGHT - 1, WIDTH - 1]]
    batch, camera, sample = page.text_content(".where b").split(" / ")
    sidecar = read_frame(frame_stem(out / batch, "annotation", camera, int(sample))).sidecar
    for row, column in places:
        x = box["x"] + (column + 0.5) * box["width"] / WIDTH
        y = box["y"] + (row + 0.5) * box["height"] / HEIGHT
        page.mouse.move(x, y)
        told = dict(
            page.eval_on_selector_all(
                "#readout div", "all => all.map(d => [d.dataset.name, d.textContent])"
            )
        )
        told = {name: text.removeprefix(name) for name, text in told.items()}
        assert told["pixel"] == f"{column}, {row}"
        for level, names in made_output.LABELS.items():
            number = int(passes[f"label.{level}"][row, column])
            assert told[level] == f"{names[number]} ({number})"
        number = int(passes["instance"][row, column])
        assert told["instance"] == (str(number) if number else "none")
        if number:
            line = table["id"].tolist().index(number)
            assert told["of"] == f"rocks {table['local_id'][line]}"
            seen, whole = int(table["pixels"][line]), int(table["amodal"][line])
            assert re.sub(r"\D+", "", told["seen"].split(" ")[0]) == str(seen)
            assert float(told["hidden"].split(" ")[0]) == pytest.approx(
                100 * (1 - seen / whole), rel=0.01
            )
        depth = float(passes["depth"][row, column])
        if not np.isfinite(depth):
            assert told["depth"] == "∞ (nothing hit)"
            assert "world" not in told
            continue
        meters, off = re.fullmatch(r"(\S+) m ± (\S+)", told["depth"]).groups()
        assert abs(float(meters) - depth) <= 1.05 * float(off) + 1e-5 * depth
        k, pose = np.array(sidecar.intrinsics), np.array(sidecar.camera_to_world)
        ray = np.linalg.solve(k, [column + 0.5, row + 0.5, 1.0])
        world = pose[:3, :3] @ (depth * ray) + pose[:3, 3]
        assert (
            np.abs(np.array(told["world"].split(", "), float) - world).max() < 0.01 + depth * 1e-3
        )


def test_the_keyboard_does_it_all(page):
    page.focus("#grid")
    selected = lambda: page.get_attribute('.tile[aria-selected="true"]', "data-frame")  # noqa: E731
    assert selected() == "0"
    page.keyboard.press("ArrowRight")
    assert selected() == "1"
    page.keyboard.press("ArrowDown")
    below = int(selected())
    assert below > 2
    page.keyboard.press("ArrowUp")
    page.keyboard.press("Home")
    assert selected() == "0"
    assert page.get_attribute("#grid", "aria-activedescendant") == "t0"
    page.keyboard.press("Enter")
    assert page.is_visible("#viewer")
    first = page.text_content(".where b")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("ArrowRight")
    assert page.text_content(".where b") != first
    page.keyboard.press("d")
    page.wait_for_selector('#large[data-done$="/depth"]')
    for _ in range(12):
        page.keyboard.press("Tab")
        assert page.evaluate("document.activeElement.closest('#viewer') !== null")
    page.keyboard.press("Escape")
    assert not page.is_visible("#viewer")
    assert selected() == "2"
    page.keyboard.press("?")
    assert page.is_visible("#help")
    page.keyboard.press("Escape")
    assert not page.is_visible("#help")
    page.keyboard.press("s")
    assert page.is_visible("#stats")
    page.keyboard.press("m")
    assert page.is_visible("#map")
    page.keyboard.press("f")
    assert page.is_visible("#grid")


def test_filters_and_sorting_choose_frames(page):
    page.select_option('[data-filter="backend"]', label="second")
    assert page.text_content("#counts") == "12 of 24 frames"
    page.select_option('[data-filter="camera"]', label="rover_right")
    page.select_option('[data-filter="batch"]', label="batch_0001")
    assert page.text_content("#counts") == "3 of 24 frames"
    page.select_option('[data-filter="only"]', "faults")
    assert page.text_content("#counts") == "1 of 24 frames"
    page.select_option('[data-filter="only"]', "")
    page.select_option('[aria-label="Sort by"]', "sample")
    page.click('[aria-label="Descending"]')
    order = page.eval_on_selector_all(".tile", "all => all.map(t => t.getAttribute('aria-label'))")
    assert [re.search(r"/ (\d+),", text).group(1) for text in order] == ["2", "1", "0"]
    page.select_option('[data-filter="batch"]', label="batch_0000")
    page.select_option('[data-filter="only"]', "faults")
    assert page.is_visible(".empty")


def test_a_class_is_highlighted_and_frames_are_sorted_by_it(page, out):
    page.focus("#grid")
    page.keyboard.press("Enter")
    open_layer(page, "label.class")
    before = canvas_pixels(page, "#large").astype(int)
    page.click('#facts [data-level="class"][data-id="3"]')
    page.wait_for_selector('#large[data-done$="/label.class"]')
    after = canvas_pixels(page, "#large").astype(int)
    rock = frame_at(out, page)["label.class"] == 3
    assert (before[rock] == after[rock]).all()
    assert (np.abs(before[~rock] - after[~rock]).sum(axis=1) > 60).all()
    page.keyboard.press("Escape")
    page.select_option('[aria-label="Sort by"]', "share")
    page.click('[aria-label="Descending"]')
    shares = page.eval_on_selector_all(
        ".tile:not(.faulty) em", "all => all.map(e => parseFloat(e.textContent))"
    )
    assert shares == sorted(shares, reverse=True)


def test_the_map_selects_the_frame_under_the_pointer(page):
    page.keyboard.press("m")
    page.wait_for_selector("#map-bar select")
    box = page.locator("#map-canvas").bounding_box()
    colors = np.unique(canvas_pixels(page, "#map-canvas").reshape(-1, 3), axis=0)
    assert len(colors) > 500
    # Poses of sample s stand at (1 + s, -2); the ground reaches from -3.1 to 9.1, -4.1 to 4.1.
    scale = min((box["width"] - 40) / 12.2, (box["height"] - 40) / 8.2)
    spot = (
        box["x"] + box["width"] / 2 + scale * (3 - 3.0),
        box["y"] + box["height"] / 2 + scale * 2,
    )
    page.mouse.move(*spot)
    page.wait_for_selector("#map-side .preview")
    assert page.text_content("#map-side b").endswith("/ 2")
    told = page.text_content("#map-at")
    x, y = re.match(r"x (\S+), y (\S+?),? ", told).groups()
    assert float(x) == pytest.approx(3, abs=0.02)
    assert float(y) == pytest.approx(-2, abs=0.02)
    ground = float(re.search(r"ground (\S+) m", told).group(1))
    assert ground == pytest.approx(3 * np.exp(-(0**2 + 10**2) / 200), abs=0.02)
    page.mouse.down()
    page.mouse.up()
    assert page.is_visible("#viewer")


def test_the_map_shows_slope_and_class_in_their_legends_colors_and_the_place_on_the_body(page):
    page.keyboard.press("m")
    page.wait_for_selector("#map-legend select")
    box = page.locator("#map-canvas").bounding_box()
    scale = min((box["width"] - 40) / 12.2, (box["height"] - 40) / 8.2)
    middle = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    for layer, count in (("slope", 8), ("traversability", 4)):
        page.select_option("#map-legend select", layer)
        legend = page.eval_on_selector_all(
            "#map-legend .swatch",
            "all => all.map(e => [e.parentNode.textContent, getComputedStyle(e).backgroundColor])",
        )
        assert len({color for _, color in legend}) == len(legend) == count
        colors = {name: np.array(re.findall(r"\d+", color), int) for name, color in legend}
        pixels = canvas_pixels(page, "#map-canvas").astype(int)
        # Clear of poses, which are blended.
        for x, y in ((-2.5, 3.0), (0.9, 3.1), (4.0, -3.3), (8.3, 2.0)):
            u, v = scale * (x - 3.0), -scale * y
            page.mouse.move(middle[0] + u, middle[1] + v)
            told = page.text_content("#map-at")
            slope = float(re.search(r"slope (\S+)°", told).group(1))
            assert slope == pytest.approx(2 * (x + 3.1), abs=0.25 + 0.2 + 0.05)
            kind = TRAVERSABILITY[min(int((x + 3.1) / 3.05), 3)]
            assert f", {kind}," in told
            latitude, longitude = map(
                float, re.search(r"e (\S+)°, longitude (\S+)°", told).groups()
            )
            at = map(float, re.match(r"x (\S+), y (\S+) m", told).groups())
            # Shown to half a centimeter.
            expected = PLACE.latitude_longitude(*at)
            meters = np.radians(1) * PLACE.semi_major_m
            assert (latitude - expected[0]) * meters == pytest.approx(0, abs=0.02)
            turn = (longitude - expected[1] + 180) % 360 - 180
            assert turn * meters * np.cos(np.radians(latitude)) == pytest.approx(0, abs=0.02)
            name = (
                kind if layer != "slope" else f"{5 * int(slope // 5)} to {5 * int(slope // 5) + 5}°"
            )
            shown = pixels[round(box["height"] / 2 + v), round(box["width"] / 2 + u)]
            # Darker by the relief's shade, of the legend's hue.
            shade = shown.sum() / colors[name].sum()
            assert 0.3 < shade <= 1.02
            assert np.abs(shown - shade * colors[name]).max() <= 4


def test_statistics_say_what_the_frames_hold(page, out):
    page.keyboard.press("s")
    cards = page.locator("#stats figcaption b").all_text_contents()
    for title in ("Pixels, level class", "Instances by class", "Distance", "Sun",
                  "Hidden part of instances", "Seconds a frame, by step"):  # fmt: skip
        assert title in cards
    rock = total = 0
    # Of two backends' frames the first's that can be read; annotation comes last.
    for path in out.glob("batch_*/frames/second/*/*.exr"):
        if path.read_bytes() == b"no EXR":
            continue
        labels = read_frame(path).passes["label.class"]
        rock, total = rock + int((labels == 3).sum()), total + labels.size
    text = page.locator("#stats figure", has_text="Pixels, level class").inner_text()
    assert f"{total:,} pixels" in text
    shown = float(re.search(r"rock\s+([\d.]+) %", text).group(1))
    assert shown == pytest.approx(100 * rock / total, rel=0.01)
    assert "at full resolution" in page.locator("#stats .prose").inner_text()


def test_reloading_comes_back_to_the_same_frame(page):
    page.focus("#grid")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("Enter")
    open_layer(page, "depth")
    where = page.text_content(".where b")
    page.reload()
    page.wait_for_selector('#large[data-done$="/depth"]')
    assert page.text_content(".where b") == where


@pytest.mark.parametrize("width", [400, 2500])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_nothing_sticks_out_at_any_width(chromium, page_file, width, scheme):
    with opened_page(chromium, page_file, width, 700, color_scheme=scheme) as page:
        dark = page.evaluate("getComputedStyle(document.body).backgroundColor")
        assert (sum(map(int, re.findall(r"\d+", dark))) < 200) == (scheme == "dark")
        for key in ("f", "m", "s"):
            page.keyboard.press(key)
            assert page.evaluate("document.documentElement.scrollWidth") <= width
        page.keyboard.press("f")
        page.focus("#grid")
        page.keyboard.press("Enter")
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        close = page.locator("#close").bounding_box()
        assert 0 <= close["x"] <= width - close["width"]


def test_controls_have_names_and_focus_shows(page):
    nameless = page.evaluate(
        """[...document.querySelectorAll("button, select, input, [role=option]")].filter(
            e => !(e.getAttribute("aria-label") || e.textContent.trim())).map(e => e.outerHTML)"""
    )
    assert nameless == []
    page.keyboard.press("Tab")
    page.keyboard.press("Tab")
    outline = page.evaluate("getComputedStyle(document.activeElement).outlineStyle")
    assert outline != "none"


def test_ten_thousand_frames_scroll_with_a_few_tiles(chromium, tmp_path):
    """The page of few frames, each many times over."""
    few = made_output.make_output(tmp_path / "few", samples=3)
    write_view(few, tmp_path / "few.html")
    text = (tmp_path / "few.html").read_text(encoding="utf-8")
    element = '<template id="'
    start = text.index(f'{element}index">')
    end = text.index("</template>", start)
    index = json.loads(text[start + len(f'{element}index">') : end])
    data = [
        part.partition("</template>")[0].partition(">")[2] for part in text.split(element)[1:13]
    ]
    more = []
    for number in range(12, 10_000):
        row = json.loads(json.dumps(index["frames"][number % 12]))
        row[0][3] = number
        index["frames"].append(row)
        more.append(f'{element}f{number}">{data[number % 12]}</template>\n')
    told = json.dumps(index, ensure_ascii=False).replace("<", "\\u003c")
    parts = [text[:start], *more, f'{element}index">', told, text[end:]]
    (tmp_path / "many.html").write_text("".join(parts), encoding="utf-8")
    with opened_page(chromium, tmp_path / "many.html") as page:
        assert page.text_content("#counts") == "10,000 frames"
        for part in (0.3, 0.9, 0.5):
            page.evaluate(f"document.querySelector('#grid').scrollTop = "
                          f"{part} * document.querySelector('#grid').scrollHeight")  # fmt: skip
            page.wait_for_function(
                """() => {
                    const room = document.querySelector("#grid").getBoundingClientRect();
                    const done = [...document.querySelectorAll(".tile canvas[data-done]")];
                    return done.map((tile) => tile.getBoundingClientRect()).some(
                        (box) => box.bottom > room.top && box.top < room.bottom);
                }"""
            )
            assert page.locator(".tile").count() < 100
        page.focus("#grid")
        page.keyboard.press("End")
        assert page.get_attribute('.tile[aria-selected="true"]', "data-frame") == "9999"
        page.wait_for_selector("#t9999 canvas[data-done]")
        page.keyboard.press("Home")
        page.keyboard.press("s")
        assert page.is_visible("#stats figure")
