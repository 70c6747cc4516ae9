"""Filmstrips and the renderer beneath them: does the picture show the body where it is?"""

import numpy as np
import pytest
import torch
from PIL import Image, ImageDraw

from moveset.errors import FormatError, InputError
from moveset.io import filmstrip as strips
from moveset.io.body_mesh import body_meshes
from moveset.io.filmstrip import filmstrip, filmstrip_metadata, telling_frames, travel_in_words, write_filmstrip
from moveset.io.render import BACKGROUND, Painter, fitted, font, three_quarter_view
from moveset.motion import rotations
from moveset.motion.clip import Motion
from moveset.motion.retarget import retarget
from moveset.motion.skeleton import HML22, Skeleton
from tests.motions import gait, wander


def standing(frames=1, **turns):
    """A body at rest with some joints turned by (axis, degrees)."""
    local = rotations.identity(frames, 22)
    for joint, (axis, angle) in turns.items():
        local[:, HML22.index(joint)] = rotations.about(axis, float(angle))
    return Motion(local, torch.tensor([0.0, 0.97, 0.0]).expand(frames, 3).clone())


def mask(picture, tone):
    """Pixels of about the hue of "left" (orange), "right" (blue) or "face" (dark)."""
    r, g, b = np.asarray(picture, dtype=int).transpose(2, 0, 1)
    if tone == "face":
        return (r + g + b < 250) & (abs(b - r) < 30)
    return r - b > 60 if tone == "left" else (b - r > 60) & (g - r > 25)


@pytest.fixture(scope="module")
def picture():
    motion = standing(left_shoulder=("z", 80))
    return Painter(motion, three_quarter_view(motion, 300, 300)).frame(0)


def test_ray_caster_covers_what_the_mesh_covers():
    """Oracle: the triangles of the GLB body, posed by matrices and filled by Pillow, have the same outline."""
    motion = wander(3, seed=2, bend=0.4)
    view = three_quarter_view(motion, 400, 400)
    picture = np.asarray(Painter(motion, view).frame(1), dtype=int)
    outline = Image.new("1", (1600, 1600))
    draw = ImageDraw.Draw(outline)
    turn = rotations.to_matrix(motion.global_rotations[1]).numpy()
    for mesh in body_meshes(HML22).values():
        local = mesh.positions - HML22.rest_positions.numpy()[mesh.joints]
        world = np.einsum("vij,vj->vi", turn[mesh.joints], local) + motion.joints[1].numpy()[mesh.joints]
        seen = (world - view.targets[1]) @ view.axes.T
        at = np.stack((200 + seen[:, 0] * view.scale, 200 - seen[:, 1] * view.scale), axis=1) * 4
        for triangle in mesh.triangles:
            draw.polygon([tuple(p) for p in at[triangle]], fill=1)
    expected = np.asarray(outline.convert("L").resize((400, 400), Image.Resampling.BOX)) > 127
    empty = np.asarray(Painter(motion, view)._ground(1), dtype=int)
    covered = np.abs(picture - empty).sum(axis=2) > 12
    overlap = (covered & expected).sum() / (covered | expected).sum()
    assert overlap > 0.96


def test_joints_lie_where_the_camera_projects_them(picture):
    motion = standing(left_shoulder=("z", 80))
    view = three_quarter_view(motion, 300, 300)
    for joint, tone in (("left_wrist", "left"), ("right_wrist", "right"), ("left_ankle", "left")):
        x, y, _ = view.axes @ (motion.joints[0, HML22.index(joint)].numpy() - view.targets[0])
        column, row = round(150 + x * view.scale), round(150 - y * view.scale)
        assert mask(picture, tone)[row - 3 : row + 4, column - 3 : column + 4].any(), joint


def test_left_and_right_up_and_down_front_and_back_can_be_told(picture):
    left, right, face = (np.argwhere(mask(picture, tone)) for tone in ("left", "right", "face"))
    assert left[:, 0].min() < face[:, 0].min() < right[:, 0].min(), "the raised left hand is above the head"
    assert face[:, 1].mean() > 150, "the body faces the right of the picture"
    view = three_quarter_view(standing(), 300, 300)
    front, back = (Painter(m, view).frame(0) for m in (standing(), standing(pelvis=("y", 180))))
    heads = [mask(each.crop((0, 0, 300, 110)), "face").sum() for each in (front, back)]
    assert heads[0] > 40
    assert heads[1] < 0.4 * heads[0], "a head seen from behind shows next to nothing of its face"


@pytest.mark.parametrize("size", [(208, 300), (480, 480), (640, 200)])
@pytest.mark.parametrize("seed", [0, 1])
def test_body_stays_inside_the_picture(size, seed):
    motion = wander(40, seed=seed, bend=0.5, turn=2.0)
    painter = Painter(motion, three_quarter_view(motion, *size, below=30))
    for frame in range(0, 40, 7):
        body = mask(painter.frame(frame), "left") | mask(painter.frame(frame), "right")
        assert body.any()
        edges = (body[0], body[-30:], body[:, 0], body[:, -1])
        assert not any(edge.any() for edge in edges)


def test_camera_follows_a_walk():
    walk = gait(80, speed=1.5)
    painter = Painter(walk, three_quarter_view(walk, 300, 300))
    middles = [np.argwhere(mask(painter.frame(k), "right"))[:, 1].mean() for k in (10, 40, 70)]
    assert np.ptp(middles) < 40


def test_strip_has_a_panel_for_every_pose(tmp_path):
    write_filmstrip(gait(60), tmp_path / "a.png", caption="a person walks", metadata='{"seed": 7}')
    with Image.open(tmp_path / "a.png") as sheet:
        assert sheet.format == "PNG"
        assert sheet.width == 9 * 208
        found = mask(sheet.convert("RGB"), "right").any(axis=0).reshape(9, 208)
    assert (found.sum(axis=1) > 15).all()
    assert filmstrip_metadata(tmp_path / "a.png") == {"seed": 7}


@pytest.mark.parametrize("frames", [1, 2, 8, 9, 10, 400])
def test_strips_of_any_length(frames):
    sheet = filmstrip(gait(frames))
    assert sheet.width == 208 * min(frames, 9)
    chosen = telling_frames(gait(frames), 9)
    assert chosen == sorted(set(chosen))
    assert (chosen[0], chosen[-1], len(chosen)) == (0, frames - 1, min(frames, 9))


def test_a_brief_kick_is_in_the_strip():
    motion = standing(200)
    for frame in range(87, 92):
        motion.rotations[frame, HML22.index("right_hip")] = rotations.about("x", -80.0)
    assert any(87 <= frame < 92 for frame in telling_frames(motion, 9))


def test_any_skeleton_can_be_drawn():
    crane = Skeleton("crane", ("base", "arm", "hook"), (-1, 0, 1), torch.tensor([[0, 0, 0], [0, 2.0, 0], [1.0, 0, 0]]))
    motion = Motion(rotations.identity(3, 3), torch.zeros(3, 3), 20.0, crane)
    pixels = np.asarray(filmstrip(motion), dtype=int)
    assert (np.abs(pixels - BACKGROUND).sum(axis=2) > 90).mean() > 0.01
    filmstrip(retarget(gait(3), "ue5"))
    filmstrip(retarget(gait(3), "kit21"))


def test_captions_fit():
    text = "a person " + "walks and " * 30
    for size, room, lines in ((15, 200, 1), (15, 200, 2), (22, 700, 1)):
        shown = fitted(text, size, room, lines).split("\n")
        assert len(shown) <= lines
        assert max(font(size).getlength(line) for line in shown) <= room
        assert shown[-1].endswith("…")
    assert fitted("a b", 15, 200) == "a b"
    assert fitted("", 15, 200) == ""
    assert fitted("x" * 500, 15, 200).endswith("…")


def test_a_caption_may_be_of_any_length():
    """A file may remember a million letters without a blank: measuring them one by one took for ever."""
    for caption in ("x" * 1_100_000, "x " * 550_000):
        assert fitted(caption, 22, 300).endswith("…")
        assert font(22).getlength(fitted(caption, 22, 300)) <= 300


def test_travel_and_turns_in_words():
    walk = gait(41, speed=1.0)
    turned = walk.transformed(rotations.yaw(torch.tensor(2.0)), torch.tensor([5.0, 0, 5.0]))
    assert travel_in_words(walk) == travel_in_words(turned) == "2.0 m forward"
    spin = standing(41)
    spin.rotations[:, 0] = rotations.yaw(torch.linspace(0, -6.2832 * 1.25, 41))
    assert travel_in_words(spin) == "on the spot, turns 450° right"


def test_metadata_of_other_files_is_refused(tmp_path):
    (tmp_path / "a.png").write_bytes(b"no picture")
    with pytest.raises(FormatError, match="no PNG"):
        filmstrip_metadata(tmp_path / "a.png")
    with pytest.raises(InputError, match="cannot read"):
        filmstrip_metadata(tmp_path / "none.png")
    Image.new("RGB", (4, 4)).save(tmp_path / "b.png")
    assert filmstrip_metadata(tmp_path / "b.png") == {}
    assert strips.filmstrip(gait(2)).mode == "RGB"
