import math
import re
import sys
from dataclasses import replace
from datetime import UTC, datetime
from html import escape
from html.parser import HTMLParser

import numpy as np
import pytest
from calibrated import NAN, SIGMA_PX, made_up_calibration

from roadblock.errors import MissingExtraError, OutputError
from roadblock.geometry.pose import inverse, transform
from roadblock.geometry.projection import project
from roadblock.io.calibration import calibration_record
from roadblock.viz import calibration_plots as plots
from roadblock.viz import calibration_report
from roadblock.viz.calibration_report import (
    calibration_page,
    in_metres,
    range_sentence,
    scale_sentence,
    write_calibration_page,
)
from roadblock.viz.page import library, look


def record_of(calibration, **others):
    return calibration_record(
        calibration, source={"left": "<left>"}, settings={"lens": "auto"}, started=datetime.now(UTC), **others
    )


def page_of(calibration, **others):
    return calibration_page(calibration, record_of(calibration, **others))


def drawn(panels):
    with library("drawing").rc_context(look()):
        return calibration_report._plots(panels)


class Reader(HTMLParser):
    """Collects tags, cells and text; complains about tags that are never closed."""

    def __init__(self, text):
        super().__init__()
        self.open, self.links, self.ids, self.cells, self.text = [], [], [], [], ""
        self.feed(text)
        self.text = " ".join(self.text.split())
        assert not self.open

    def handle_starttag(self, tag, attrs):
        if tag not in ("meta", "br"):
            self.open.append(tag)
        self.links += [value for name, value in attrs if name in ("src", "href", "xlink:href", "data", "action")]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data
        if self.open and self.open[-1] in ("td", "th"):
            self.cells.append(data)


@pytest.fixture
def quick(monkeypatch):
    """Leave the drawing out."""
    monkeypatch.setattr(calibration_report, "_plot", lambda panel, *_: f"<p>{escape(panel.caption)}</p>")


@pytest.fixture(scope="module")
def text():
    return page_of(made_up_calibration(), without_board=["left77<"])


def test_the_page_is_whole_and_fetches_nothing(text):
    reader = Reader(text)
    assert all(link.startswith("#") for link in reader.links)
    assert not re.search(r"url\((?!#)|@import|<script|<link|<img|<image", text)
    assert text.startswith("<!doctype html>")
    assert text.count("<svg") == 4 + 2 + 2 + 1 + 4 + 2


def test_the_page_reads_in_light_and_dark(text):
    assert "prefers-color-scheme: dark" in text
    assert "currentColor" in text
    for svg in re.findall("<svg.*?</svg>", text, re.DOTALL):
        assert not re.search(r"#000000|#ffffff|#010203", svg)


def test_the_verdict_comes_first_with_the_range_errors(text):
    body = Reader(text[text.index("<h1>") : text.index("</body>")]).text
    assert body.index("Usable, with care.") < body.index("0.84 mm at 5 m") < body.index("Next picture.")
    assert body.index("Next picture.") < body.index("Predicted range error")
    for words in (
        "Hold the board at the upper right, 2 m away, tilted left. It would bring the range error at 20 m to 71%",
        "its scale cannot be seen in pictures",
        "8 of 10 views used; baseline 120.054 mm; residuals 0.042 px RMS",
        "The range error at 20 m is above 1 %.",
        "The upper right corner of both images is empty.",
    ):
        assert words in body


def test_what_was_left_out_tried_and_found_stands_in_tables(text):
    cells = Reader(text).cells
    for row in (
        ["left08", "its corners lie 0.37 px off: the board moved, or is another one"],
        ["left77<", "no board found in it"],
        ["brown_conrady5", "24", "0.0410", "0.0440", "chosen: fits unseen views best"],
        ["kannala_brandt", "22", "0.0620", "–", "fits worse"],  # noqa: RUF001
        ["left.fx_px", "78.57", "0.4"],
        ["tx_m", "0.12", "0.0001"],
    ):
        at = cells.index(row[0])
        assert cells[at : at + len(row)] == row


def test_the_table_of_ranges_tells_the_rms_and_the_worst_place(quick):
    calibration = made_up_calibration()
    calibration.range_sigma_m[40.0][:] = NAN
    cells = Reader(page_of(calibration)).cells
    field = calibration.range_sigma_m[20.0][:, 1:]
    figures = (np.median(field), field.max(), math.sqrt((field**2).mean()))
    at = cells.index("20 m")
    assert cells[at : at + 4] == ["20 m", *(f"{1000 * figure:.0f} mm" for figure in figures)]
    at = cells.index("40 m")
    assert cells[at : at + 4] == ["40 m", "unknown", "unknown", "unknown"]


@pytest.mark.parametrize(("verdict", "words"), [("good", "can be used"), ("refused", "cannot support the rig")])
def test_verdicts(quick, verdict, words):
    text = page_of(made_up_calibration(verdict=verdict))
    assert f'class="verdict {verdict}"' in text
    assert words in Reader(text).text


def test_nothing_is_left_out_and_no_view_would_help(quick):
    calibration = made_up_calibration()
    views = calibration.views[:-1]
    calm = replace(calibration, views=views, coverage=replace(calibration.coverage, missing=(), next_view=""))
    text = page_of(calm)
    assert "Left out" not in text
    assert "Next picture" not in text
    unsure = replace(calibration.coverage, next_gain=NAN)
    assert "It would bring" not in page_of(replace(calibration, coverage=unsure))


def test_a_set_that_gave_nothing_still_has_a_page():
    calibration = made_up_calibration(verdict="refused")
    out = tuple(
        replace(view, left_out="no pose", T_left_board=None, residual_left_px=NAN * view.residual_left_px,
                residual_right_px=NAN * view.residual_right_px)
        for view in calibration.views
    )  # fmt: skip
    coverage = replace(
        calibration.coverage, left_counts=np.zeros((6, 8)), right_counts=np.zeros((6, 8)),
        distances_m=np.zeros(0), tilts_deg=np.zeros((0, 2)),
    )  # fmt: skip
    fields = {z_m: NAN * field for z_m, field in calibration.range_sigma_m.items()}
    empty = replace(
        calibration, views=out, coverage=coverage, range_sigma_m=fields, lens_trials=(), sigma_px=(NAN, NAN)
    )
    text = page_of(empty)
    assert text.count("<svg") == 1 + 2
    assert "How far off ranges will be cannot be told." in text
    assert page_of(replace(empty, views=())).count("<svg") == 2


def test_unknown_noise_leaves_the_curves_out():
    calibration = made_up_calibration()
    alone = tuple(replace(fit, expected_sigma_px=NAN) for fit in calibration.cameras_alone)
    text = drawn(plots.noise_panels(replace(calibration, sigma_px=(NAN, NAN), cameras_alone=alone)))
    assert "corner fits expect" not in text
    assert "normal," not in text


def test_many_views_show_the_worst():
    calibration = made_up_calibration(views=plots.MOST_BARS + 9)
    text = drawn(plots.view_panels(calibration))
    assert f"The {plots.MOST_BARS} worst of {plots.MOST_BARS + 9} views" in text
    assert calibration.views[-1] in plots._bars(calibration)


def test_commit_may_be_unknown(quick):
    calibration = made_up_calibration()
    assert "commit unknown" in calibration_page(calibration, {**record_of(calibration), "commit": None})


@pytest.mark.parametrize(
    ("length_m", "words"),
    [
        (0.00042, "0.42 mm"), (0.0034, "3.4 mm"), (0.0149, "15 mm"), (0.0994, "99 mm"), (0.1234, "0.12 m"),
        (0.35, "0.35 m"), (3.14, "3.1 m"), (44.4, "44 m"), (0.0, "0 mm"), (NAN, "unknown"),
    ],
)  # fmt: skip
def test_lengths_in_words(length_m, words):
    assert in_metres(length_m) == words


def test_sentences():
    calibration = made_up_calibration(square_sigma_m=0.00006)
    assert "measured as 30 mm, +- 0.20%" in scale_sentence(calibration)
    assert "40 mm at 20 m" in scale_sentence(calibration)
    calibration.range_sigma_m[5.0][:] = NAN
    assert " at 5 m" not in range_sentence(calibration)
    assert "13 mm at 20 m" in range_sentence(calibration)


def test_points_stand_where_they_were_measured():
    """The prediction plus the residual, in each camera, for the board with its bow."""
    calibration = made_up_calibration()
    rig, view = calibration.rig, calibration.views[2]
    bent = calibration.board.points_m + np.stack(
        [0 * calibration.board_heights_m] * 2 + [calibration.board_heights_m], 1
    )
    in_left = transform(view.T_left_board, bent)
    in_right = transform(inverse(rig.T_left_right), in_left)
    np.testing.assert_allclose(
        plots._places(calibration, 0)[2], project(rig.left, in_left) + view.residual_left_px, atol=1e-9
    )
    np.testing.assert_allclose(
        plots._places(calibration, 1)[2], project(rig.right, in_right) + view.residual_right_px, atol=1e-9
    )


def test_rows_agree_where_nothing_is_wrong_and_show_what_is():
    calibration = made_up_calibration()
    exact = tuple(
        replace(view, residual_left_px=0 * view.residual_left_px, residual_right_px=0 * view.residual_right_px)
        for view in calibration.views
    )
    calm = replace(calibration, views=exact)
    places = [plots._places(calm, side) for side in (0, 1)]
    assert np.nanmax(np.abs(plots._row_errors(calm, places))) < 1e-6
    places[0] = places[0] + (0.0, 0.1)
    # A row of the raw image is a row of the rectified one times a scale near 1.
    assert np.nanmean(plots._row_errors(calm, places)) == pytest.approx(0.1, rel=0.3)


def test_the_histogram_holds_all_residuals_of_used_views():
    calibration = made_up_calibration()
    left, _ = plots._residuals(calibration)
    expected = sum(int(np.isfinite(view.residual_left_px).sum()) for view in calibration.views[:-1])
    assert len(left) == expected
    assert left.std() == pytest.approx(SIGMA_PX, rel=0.15)


def test_bare_frames_have_no_arrows():
    calibration = made_up_calibration()
    unseen = tuple(replace(view, residual_right_px=NAN * view.residual_right_px) for view in calibration.views)
    assert ">0 points" in drawn(plots.residual_panels(replace(calibration, views=unseen)))


def test_without_matplotlib_the_extra_is_named(monkeypatch, tmp_path):
    calibration = made_up_calibration()
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MissingExtraError, match=r"drawing the calibration's page .*roadblock\[report\]"):
        write_calibration_page(tmp_path / "page.html", calibration, record_of(calibration))
    assert not list(tmp_path.iterdir())


def test_the_page_is_written_whole_or_not_at_all(quick, tmp_path):
    calibration = made_up_calibration()
    write_calibration_page(tmp_path / "page.html", calibration, record_of(calibration))
    assert (tmp_path / "page.html").read_text("utf-8").endswith("</html>\n")
    (tmp_path / "taken").mkdir()
    with pytest.raises(OutputError, match=r"cannot write .*taken: .*--out"):
        write_calibration_page(tmp_path / "taken", calibration, record_of(calibration))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["page.html", "taken"]
