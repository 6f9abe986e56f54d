"""The page, small and large, as a real browser sees it, and as its text reads."""

import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from report_pages import measure, synthetic, trace_of

from lerobot_lisa.analysis.material import Material
from lerobot_lisa.analysis.recording.traces import Trace
from lerobot_lisa.analysis.report.build import PAGE, build
from lerobot_lisa.analysis.training_data import TrainingData

NOWHERE = TrainingData(None, None, "The training data are <b>nowhere</b>.")


@pytest.fixture(scope="module", params=[(20, 18), (100, 900)], ids=["20 codes", "100 codes"])
def folder(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A report of a made-up evaluation."""
    made = tmp_path_factory.mktemp("report")
    codes, words = request.param
    build(made, Material(synthetic(codes, words), NOWHERE, permutations=20))
    return made


class Links(HTMLParser):
    """Collects elements that load something, and all links."""

    def __init__(self) -> None:
        super().__init__()
        self.links: list[str] = []
        self.sources: list[str] = []
        self.tags: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        for name, value in attrs:
            if name == "href":
                self.links.append(value or "")
            if name in ("src", "srcset", "data"):
                self.sources.append(value or "")


def test_a_browser_shows_every_image_and_fetches_nothing(folder: Path, tmp_path: Path) -> None:
    seen = measure(folder / PAGE, tmp_path / "profile")
    assert len(seen["images"]) > 20
    assert all(seen["images"])
    assert seen["outside"] == []

    assert seen["wide"] <= 0
    assert brightness(seen["paper"]) > 200


def test_a_small_dark_window(folder: Path, tmp_path: Path) -> None:
    seen = measure(folder / PAGE, tmp_path / "profile", "--blink-settings=preferredColorScheme=0", width=500)
    assert seen["wide"] <= 0
    assert brightness(seen["paper"]) < 60


def brightness(colour: str) -> float:
    """Of a colour such as "rgb(1, 2, 3)", 0 to 255."""
    return sum(int(part) for part in re.findall(r"\d+", colour)[:3]) / 3


def test_the_page_needs_neither_scripts_nor_anything_from_elsewhere(folder: Path) -> None:
    page = (folder / PAGE).read_text(encoding="utf-8")
    found = Links()
    found.feed(page)
    assert not found.tags & {"script", "iframe", "object", "embed"}
    assert all(source.startswith("data:image/png;base64,") for source in found.sources)
    assert "url(" not in page
    assert "@import" not in page
    local = [link for link in found.links if not link.startswith(("#", "data:"))]
    assert len(local) > 60
    assert all((folder / link).is_file() for link in local)
    anchors = {link[1:] for link in found.links if link.startswith("#")}
    assert all(f'id="{anchor}"' in page for anchor in anchors)


def test_every_figure_has_three_files_and_a_sentence(folder: Path) -> None:
    page = (folder / PAGE).read_text(encoding="utf-8")
    names = {path.stem for path in (folder / "figures").iterdir()}
    assert {f"{name}{suffix}" for name in names for suffix in (".png", ".pdf", ".csv")} == {
        path.name for path in (folder / "figures").iterdir()
    }
    captions = re.findall(r"<figcaption>(.*?)<span", page, re.DOTALL)
    assert len(captions) == len(names)
    assert all(len(caption.split()) > 8 for caption in captions)


def test_words_are_capped_and_the_table_has_them_all(folder: Path) -> None:
    table = pd.read_csv(folder / "figures" / "skill_words_pmi.csv")
    words = table["word"].nunique()
    page = (folder / PAGE).read_text(encoding="utf-8")
    assert ("the 60 most telling of" in page) == (words > 60)
    assert len(table) == words * table["skill_code"].nunique()


def test_what_others_wrote_is_text(folder: Path) -> None:
    page = (folder / PAGE).read_text(encoding="utf-8")
    assert "<b>nowhere</b>" not in page
    assert "&lt;b&gt;nowhere&lt;/b&gt;" in page


def test_the_same_trace_gives_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        build(tmp_path / name, Material(synthetic(3, 6, episodes=9), NOWHERE, permutations=20))
    files = sorted(path.relative_to(tmp_path / "a") for path in (tmp_path / "a").rglob("*.*"))
    assert len(files) > 20
    for file in files:
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes(), file


def report_on(told: list[str], folder: Path) -> str:
    """The page about a few episodes with these instructions, each with a code of its own."""
    trace = trace_of(told, list(range(len(told))), 10, 4, 2, np.random.default_rng(0))
    known = TrainingData({told[0]}, None, "Training data: made up.")
    build(folder, Material(trace, known, permutations=20))
    return (folder / PAGE).read_text(encoding="utf-8")


@pytest.mark.filterwarnings("error")
def test_instructions_without_words(tmp_path: Path) -> None:
    page = report_on(["", "!!!", "... ?"], tmp_path)
    assert "No instruction of this evaluation has a word in it" in page
    assert not list((tmp_path / "figures").glob("*word*"))
    assert (tmp_path / "figures" / "language_information.csv").is_file()


@pytest.mark.timeout(120)  # it was minutes, and gigabytes
def test_one_word_of_a_hundred_thousand_letters(tmp_path: Path) -> None:
    page = report_on(["x" * 100_000, "go", "go on"], tmp_path)
    assert "x" * 300 not in page
    assert "x" * 30 in page
    assert "x" * 100_000 in set(pd.read_csv(tmp_path / "figures" / "skill_words_pmi.csv")["word"])


@pytest.mark.filterwarnings("ignore:Glyph")
def test_what_matplotlib_takes_for_formulas_is_text(tmp_path: Path) -> None:
    page = report_on(["buy $\\frac{", "$x^", "null \x00 and _new_ \n lines"] * 2, tmp_path)
    assert "frac" in page


def test_codes_that_have_words_are_called_by_them(tmp_path: Path) -> None:
    trace = synthetic(3, 6, episodes=9)
    names = {"codes": ["0 red ball", "1 <b>key</b>", "2 door"]}
    build(tmp_path, Material(replace(trace, origin={**trace.origin, **names}), NOWHERE, permutations=20))
    page = (tmp_path / PAGE).read_text(encoding="utf-8")
    assert "Skill 0 red ball" in page
    assert "<b>key</b>" not in page
    usage = pd.read_csv(tmp_path / "figures" / "code_usage.csv")
    assert list(usage["skill_code"]) == names["codes"]


@pytest.mark.timeout(120)
def test_nothing_grows_with_the_square_of_the_codebook(tmp_path: Path) -> None:
    """Two parts of 450 codes: a table of every code by every other would have 328 gigabytes."""
    page = build_page(synthetic(202_500, 6, episodes=9), tmp_path)
    assert "Left out: 202,490 codes that were never chosen." in page
    assert len(pd.read_csv(tmp_path / "figures" / "code_transitions.csv")) == 100


def build_page(trace: Trace, folder: Path) -> str:
    """The page about a trace."""
    build(folder, Material(trace, NOWHERE, permutations=20))
    return (folder / PAGE).read_text(encoding="utf-8")
