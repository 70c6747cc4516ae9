"""Pages of motions: what is in them, what cannot get out of them, and that they are read back."""

import base64
import hashlib
import html
import json
import re
from dataclasses import replace
from html.parser import HTMLParser

import pytest
import torch

from moveset.errors import FormatError, InputError
from moveset.io import load, read_metadata, save
from moveset.io.html import Scene, Shown, html_page, inline_player, player_script, write_html
from moveset.motion.clip import Motion
from moveset.motion.retarget import retarget
from moveset.motion.skeleton import Skeleton
from tests.motions import gait, wander

NASTY = '</script><script>alert(1)</script><!-- <b onload="x">&amp; \'"   💃 \udc83'


class Elements(HTMLParser):
    """Start tags, and the texts of scripts and title as a browser would cut them."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.texts, self._open = [], [], None
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        self._open = len(self.tags) - 1

    def handle_data(self, data):
        self.texts.append((self.tags[self._open][0] if self._open is not None else None, data))

    def of(self, tag):
        return [data for name, data in self.texts if name == tag and data.strip()]


@pytest.fixture(scope="module")
def walk():
    return gait(30)


def page_of(text):
    return json.loads(next(data for data in Elements(text).of("script") if data.startswith("{")))


def test_a_page_needs_nothing_from_anywhere(walk, tmp_path):
    save(walk, tmp_path / "a.html", metadata={"prompt": "a person walks"})
    text = (tmp_path / "a.html").read_text()
    tags = Elements(text).tags
    assert not [tag for tag, attributes in tags if tag in ("link", "img", "iframe", "style", "base", "object")]
    assert not [attributes for _, attributes in tags if {"src", "href", "style", "srcset"} & attributes.keys()]
    assert not [name for _, attributes in tags for name in attributes if name.startswith("on")]
    policy = next(a["content"] for tag, a in tags if a.get("http-equiv") == "Content-Security-Policy")
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy


def test_the_policy_allows_the_one_script(walk):
    text = html_page([Scene("walk", (Shown(walk),))])
    scripts = [(a, data) for (tag, a), data in zip(_scripts(text), Elements(text).of("script"), strict=True)]
    (_, code), (data, _) = scripts
    assert data == {"type": "application/json", "id": "moveset-page"}
    digest = base64.b64encode(hashlib.sha256(code.encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}';" in html.unescape(text)


def _scripts(text):
    return [(tag, attributes) for tag, attributes in Elements(text).tags if tag == "script"]


def test_the_player_can_stand_in_a_script_element():
    code = player_script()
    assert not re.search(r"</script|<!--|\r", code, re.IGNORECASE)
    assert len(code) < 1_000_000
    addresses = set(re.findall(r"https?://[^\"'`\s)]+", code))
    assert addresses <= {"http://www.w3.org/1999/xhtml", "http://www.w3.org/2000/svg"}, "only names of XML"


def test_what_people_wrote_is_never_markup(walk, tmp_path):
    write_html(
        tmp_path / "a.html", [Scene(NASTY, (Shown(walk, NASTY, ((NASTY, 0),)),), NASTY)], title=NASTY,
        metadata={"prompt": NASTY},
    )  # fmt: skip
    text = (tmp_path / "a.html").read_text()
    assert len(_scripts(text)) == 2
    assert Elements(text).of("title") == [NASTY.replace("\udc83", "?")]
    scene = page_of(text)["scenes"][0]
    assert (scene["title"], scene["note"], scene["takes"][0]["title"]) == (NASTY,) * 3
    assert scene["takes"][0]["prompts"] == [{"text": NASTY, "firstFrame": 0}]
    assert read_metadata(tmp_path / "a.html") == {"prompt": NASTY}


def test_frames_come_back_to_the_bit(tmp_path):
    motion = wander(40, seed=3, fps=30.0)
    save(motion, tmp_path / "a.html")
    found = load(tmp_path / "a.html")
    assert found.root.equal(motion.root)
    assert (found.rotations - motion.rotations).abs().max() < 1e-6, "made of unit length again"
    assert found.fps == 30.0
    assert found.skeleton is motion.skeleton


def test_joints_are_called_as_they_were_and_so_that_bvh_can_be_written(walk, tmp_path):
    """Half a letter, as JSON may hold it, and namespaces of references in references."""
    space = "figure:" * 14
    names = tuple(f"{space}{name}" + "\ud83d" * (name == "head") for name in walk.skeleton.joints)
    save(Motion(walk.rotations, walk.root, walk.fps, replace(walk.skeleton, joints=names)), tmp_path / "a.html")
    found = load(tmp_path / "a.html")
    assert found.skeleton.joints == tuple(name.replace("\ud83d", "?") for name in names)
    again = load(save(found, tmp_path / "b.bvh"))
    assert {*again.skeleton.joints} == {*found.skeleton.joints}


def test_roles_are_told_where_names_do_not(walk):
    page = page_of(html_page([Scene("", (Shown(retarget(walk, "mixamo")),))]))
    skeleton = page["scenes"][0]["skeleton"]
    assert skeleton["joints"][skeleton["roles"]["left_knee"]] == "mixamorig:LeftLeg"
    crane = Skeleton("crane", ("base", "mast", "jib"), (-1, 0, 1), torch.eye(3))
    for told in (walk, wander(5, seed=1, skeleton=crane)):
        assert "roles" not in page_of(html_page([Scene("", (Shown(told),))]))["scenes"][0]["skeleton"]


def test_several_prompts_are_marked_where_they_begin(walk, tmp_path):
    notes = {"prompt": "a person walks | a person waves", "starts": "0 | 0.75"}
    save(walk, tmp_path / "a.html", metadata=notes)
    [take] = page_of((tmp_path / "a.html").read_text())["scenes"][0]["takes"]
    assert take["prompts"] == [
        {"text": "a person walks", "firstFrame": 0},
        {"text": "a person waves", "firstFrame": 15},
    ]
    save(walk, tmp_path / "b.html", metadata={"prompt": notes["prompt"]})
    [take] = page_of((tmp_path / "b.html").read_text())["scenes"][0]["takes"]
    assert take["prompts"] == [{"text": "a person walks, then a person waves", "firstFrame": 0}]


def test_motions_of_one_body_stand_side_by_side_whatever_their_skeletons_are_called(walk):
    named = Motion(walk.rotations, walk.root, walk.fps, replace(walk.skeleton, name="run"))
    one, other = page_of(html_page([Scene("", (Shown(walk), Shown(named)))]))["scenes"][0]["takes"]
    assert one["data"] == other["data"]


def test_what_does_not_belong_side_by_side_is_refused(walk):
    with pytest.raises(InputError, match="one skeleton"):
        html_page([Scene("mixed", (Shown(walk), Shown(retarget(walk, "mixamo"))))])
    with pytest.raises(InputError, match="one skeleton"):
        html_page([Scene("empty", ())])
    with pytest.raises(InputError, match="at least one motion"):
        html_page([])


def test_more_than_can_be_read_back_is_refused(walk, tmp_path, monkeypatch):
    monkeypatch.setattr("moveset.io.html.MAX_BYTES", 1000)
    with pytest.raises(InputError, match="limit"):
        save(walk, tmp_path / "a.html")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("where", "what"),
    [
        (("format",), 2),
        (("scenes",), []),
        (("scenes",), None),
        (("scenes", 0, "takes"), []),
        (("scenes", 0, "takes", 0, "data"), "AAAA"),
        (("scenes", 0, "takes", 0, "data"), "ä"),
        (("scenes", 0, "takes", 0, "data"), [1]),
        (("scenes", 0, "skeleton", "parents"), [5] * 22),
        (("scenes", 0, "skeleton", "parents"), [float("inf")] * 22),
        (("scenes", 0, "skeleton", "offsets"), [["x"]]),
        (("scenes", 0, "skeleton", "offsets"), [[float("nan")] * 3] * 22),
        (("scenes", 0, "skeleton", "offsets"), [[1e30] * 3] * 22),
        (("scenes", 0, "skeleton", "joints"), ["a"]),
        (("scenes", 0, "skeleton"), 7),
    ],
)
def test_damaged_pages_are_format_errors(walk, tmp_path, where, what):
    page = page_of(html_page([Scene("", (Shown(walk),))]))
    inner = page
    for key in where[:-1]:
        inner = inner[key]
    inner[where[-1]] = what
    text = f'<script type="application/json" id="moveset-page">{json.dumps(page)}</script>'
    (tmp_path / "a.html").write_text(text)
    with pytest.raises(FormatError, match=r"page|packet"):
        load(tmp_path / "a.html")


def test_a_notebook_shows_a_page_of_its_own(walk):
    shown = walk._repr_html_()
    assert shown == inline_player(walk)
    [(tag, attributes)] = Elements(shown).tags
    assert tag == "iframe"
    assert attributes["sandbox"] == "allow-scripts allow-downloads"
    assert attributes["srcdoc"] == html_page([Scene("", (Shown(walk),))])
