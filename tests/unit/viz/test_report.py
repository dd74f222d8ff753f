import re
import sys
from html.parser import HTMLParser

import numpy as np
import pytest

from roadblock.errors import MissingExtraError, OutputError
from roadblock.viz.report import draw_errors, page, write_page

PAPER = [
    {"type": "person", "nominal_m": 5.0, "proposed_m": 5.03, "traditional_1_m": 5.24, "traditional_2_m": 5.16},
    {"type": "fork", "nominal_m": 20.0, "proposed_m": 20.01, "traditional_1_m": 20.51, "traditional_2_m": 20.33},
]
FIGURES = ("bias_m", "rms_m", "median_abs_m", "p95_abs_m", "within_1_sigma", "within_2_sigma")


def a_reading(detector, name, seed, true_m, range_m):
    return {"detector": detector, "type": name, "seed": seed, "true_range_m": true_m, "range_m": range_m}


def a_row(detector, name, n, missed, *figures):
    padded = figures or (None,) * len(FIGURES)
    return {"detector": detector, "type": name, "n": n, "missed": missed, **dict(zip(FIGURES, padded, strict=True))}


def a_comparison(name, stereo, mono, ratio):
    return {
        "type": name,
        "stereo": stereo,
        "stereo_median_abs_m": stereo and 0.101,
        "mono": mono,
        "mono_median_abs_m": mono and 0.404,
        "ratio": ratio,
    }


@pytest.fixture
def result():
    errors_m = np.random.default_rng(2).normal(0, 0.2, 12)
    readings = [a_reading("dense", "person", i, 5.1, 5.1 + e) for i, e in enumerate(errors_m)]
    readings += [a_reading("mono<&>", "person", 0, 5.1, 5.9), a_reading("mono<&>", "fork", 0, 20.0, None)]
    return {
        "version": "9.9",
        "commit": "abc123",
        "finished": "2026-01-02",
        "machine": {"cpu": "one <core>"},
        "settings": {"runs": 12, "speed_kmh": 30.0, "range": "to the nearest face", "rig": {"left": {}}},
        "runs_done": 12,
        "rows": [
            a_row("dense", "person", 12, 0, 0.0123, 0.2345, 0.1, 0.4567, 0.66, 0.97),
            a_row("mono<&>", "person", 1, 0, 0.8, 0.8, 0.8, 0.8, None, None),
            a_row("mono<&>", "fork", 1, 1),
        ],
        "comparison": [a_comparison("person", "dense", "mono<&>", 0.25), a_comparison("fork", None, None, None)],
        "paper": PAPER,
        "readings": readings,
    }


class Reader(HTMLParser):
    """Collects the tags, what they would fetch, and the text; complains about tags that are never closed."""

    def __init__(self, text):
        super().__init__()
        self.open, self.links, self.cells, self.text = [], [], [], ""
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


def test_the_page_is_whole_and_fetches_nothing(result):
    text = page(result)
    reader = Reader(text)
    assert all(link.startswith("#") for link in reader.links)
    assert not re.search(r"url\((?!#)|@import|<script|<link|<img", text)
    assert text.startswith("<!doctype html>")
    assert text.count("<svg") == 1
    assert "<?xml" not in text


def test_the_page_reads_in_light_and_dark(result):
    text = page(result)
    assert "prefers-color-scheme: dark" in text
    assert "color-scheme: light dark" in text
    svg = text[text.index("<svg") : text.index("</svg>")]
    assert "currentColor" in svg
    assert not re.search(r"#000000|#ffffff|#010203", svg)


def test_the_page_tells_every_figure(result):
    reader = Reader(page(result))
    at = reader.cells.index("dense")
    assert reader.cells[at : at + 9] == ["dense", "12", "0", "+0.012", "0.234", "0.100", "0.457", "66%", "97%"]
    assert "mono<&>" in reader.cells
    assert [cell for cell in reader.cells if "proposed" in cell] == [
        "paper, proposed: 5.03 m",
        "paper, proposed: 20.01 m",
    ]
    at = reader.cells.index("paper, traditional 1: 5.24 m")
    assert reader.cells[at : at + 5] == ["paper, traditional 1: 5.24 m", "1", "0", "+0.24", "0.24"]
    assert "person: best stereo detector dense, median |error| 0.101 m; best mono mono<&>, 0.404 m; ratio 0.25." in (
        reader.text
    )
    assert "fork: no stereo detector found it" in reader.text
    for words in ("12 independent simulated runs", "to the nearest face", "9.9, commit abc123", "one <core>"):
        assert words in reader.text
    assert "Interrupted" not in reader.text


def test_an_unfinished_run_says_so(result):
    result |= {"runs_done": 1, "commit": None}
    result["comparison"][0] = a_comparison("person", "dense", None, None)
    text = Reader(page(result)).text
    assert "1 independent simulated run " in text
    assert "Interrupted: 12 were asked for." in text
    assert "commit unknown" in text
    assert "no mono algorithm to compare with" in text


def test_the_plot_shows_detectors_misses_and_the_paper(result):
    svg = draw_errors(result)
    for words in ("person at 5 m", "fork at 20 m", "dense", "1 missed", "paper, proposed", "measured minus true"):
        assert words in svg
    assert draw_errors(result) == svg


def test_without_matplotlib_the_extra_is_named(result, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MissingExtraError, match=re.escape("roadblock[report]")):
        write_page(tmp_path / "page.html", result)
    assert not list(tmp_path.iterdir())


def test_the_page_is_written_whole_or_not_at_all(result, tmp_path):
    write_page(tmp_path / "page.html", result)
    assert (tmp_path / "page.html").read_text("utf-8") == page(result)
    assert len(list(tmp_path.iterdir())) == 1
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "file").touch()
    with pytest.raises(OutputError, match=r"cannot write .*taken: .*--out"):
        write_page(tmp_path / "taken", result)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["page.html", "taken"]
