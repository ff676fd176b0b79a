"""A page is safe with any text, shows nothing empty, and says the verdict first."""

from __future__ import annotations

import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest

from kncal.core.errors import RenderError
from kncal.observe.verdict import Verdict
from kncal.report.page import Figure, Page, Section, Table, marks, report_folder, write_page

HOSTILE = '<img src=x onerror="alert(1)"></script><script>alert(2)</script>'
BARE = Page(case="c", title="", subject="s", about="a", verdict=Verdict.of("open", ("nothing",)), sections=())


class Seen(HTMLParser):
    """Tags with attributes, and text."""

    def __init__(self, path: Path):
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data):
        self.text += data


def everything(text: str) -> Page:
    """A page with ``text`` wherever a text can stand."""
    figure = Figure(name="f", png="f.png", svg="f.svg", caption=text, alt=text)
    part = Section(title=text, text=(text,), folded=True)
    section = Section(
        title=text,
        text=(text,),
        table=Table((text,), ((text,),), below=(text,)),
        remark=text,
        notes=(text,),
        points=(text,),
        figures=(figure,),
        code=text,
        entries={text: [text, {text: 1.0}]},
        parts=(part,),
    )
    return Page(
        case=text,
        title=text,
        subject=text,
        about=text,
        verdict=Verdict.of("within", (text,) * 6),
        sections=(section,),
        provenance={text: {text: [text]}},
        files=(text,),
    )


def test_hostile_text_is_shown_in_every_place_and_obeyed_in_none(tmp_path):
    (tmp_path / "plain").mkdir()
    path, plain = write_page(everything(HOSTILE), tmp_path), write_page(everything("plain"), tmp_path / "plain")
    raw, seen = path.read_text("utf-8"), Seen(path)
    assert "<img src=x" not in raw and "<script" not in raw and raw.count("</html>") == 1
    assert [tag for tag, _ in seen.tags] == [tag for tag, _ in Seen(plain).tags]
    assert not [name for _, attributes in seen.tags for name in attributes if name.startswith("on")]
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', raw)
    assert policy is not None and policy[1].startswith("default-src 'none'") and "script" not in policy[1]
    assert seen.text.count(HOSTILE) == Seen(plain).text.count("plain")


def test_what_is_empty_is_left_out(tmp_path):
    empty = Section(title="an empty part", table=Table(("a",), ()), remark="how to read it")
    shown = Section(title="a full part", text=("words",))
    page = replace(
        BARE, sections=(Section(title="holds nothing", parts=(empty,)), Section(title="x", parts=(empty, shown)))
    )
    text = write_page(page, tmp_path).read_text("utf-8")
    assert re.findall(r"<h[23]>(.*?)</h[23]>", text) == ["x", "a full part"]


def test_a_verdict_is_a_sentence_and_a_few_points_the_rest_is_folded(tmp_path):
    sentences = [f"sentence {k}" for k in range(7)]
    box = Verdict.of("outside", sentences)
    assert (box.sentence, *box.points, *box.details) == tuple(sentences)
    assert len(box.points) == 3
    assert len(Verdict.of("outside", sentences, points=5).points) == 5
    text = write_page(replace(BARE, verdict=box), tmp_path).read_text("utf-8")
    assert text.index("sentence 3") < text.index("<summary>more</summary>") < text.index("sentence 4")


def test_numbers_stand_at_the_right_and_verdicts_have_a_colour(tmp_path):
    table = Table(("what", "value", ""), (("a", "1 m", "ok"), ("b", "2 m", "undecided")), text=(0, 2))
    text = write_page(replace(BARE, sections=(Section(title="t", table=table),)), tmp_path).read_text("utf-8")
    assert text.count('<td class="n">') == 2
    assert '<td class="good">ok</td>' in text and '<td class="unsure">undecided</td>' in text


def test_marks_are_small_numbers():
    assert marks(()) == ""
    assert marks((1, 12)) == "\u202f¹\u202f¹²"


@pytest.mark.parametrize("kind", ["file", "link"])
def test_a_report_goes_into_a_folder_only(tmp_path, kind):
    place = tmp_path / "report"
    if kind == "file":
        place.write_text("precious")
    else:
        place.symlink_to(tmp_path)
    with pytest.raises(RenderError, match="expected a folder"), report_folder(place):
        pass
