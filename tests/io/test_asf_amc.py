import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from moveset.errors import FormatError, InputError
from moveset.io.asf_amc import read_amc, read_asf
from moveset.motion import rotations

ASF = b"""# a leg
:version 1.10
:name LEG
:units
  mass 1.0
  length 0.45
  angle deg
:root
   order TX TY TZ RX RY RZ
   axis XYZ
   position 0 0 0
   orientation 0 0 0
:bonedata
  begin
     id 1
     name hip
     direction 1 0 0
     length 2
     axis 0 0 0 XYZ
  end
  begin
     id 2
     name femur
     direction 0 -2 0
     length 8
     axis 30 -20 40 XYZ
    dof rx rz
    limits (-160.0 20.0)
           (-70.0 70.0)
  end
  begin
     id 3
     name tibia
     direction 0 -1 0
     length 7
     axis 0 0 90 XYZ
    dof rx
    limits (-10.0 170.0)
  end
:hierarchy
  begin
    root hip
    hip femur
    femur tibia
  end
"""
AMC = b"""#!OML:ASF leg
:FULLY-SPECIFIED
:DEGREES
5
root 1 2 3 10 20 30
femur 40 50
tibia 60
6
root 4 5 6 0 0 0
femur 0 0
tibia -90
"""
METRES = 0.0254 / 0.45


@pytest.fixture
def leg(tmp_path):
    (tmp_path / "leg.asf").write_bytes(ASF)
    return read_asf(tmp_path / "leg.asf")


def load(tmp_path, asf, data):
    path = tmp_path / "a.amc"
    path.write_bytes(data)
    return read_amc(path, asf)


def test_the_skeleton(leg):
    assert leg.bones == ("root", "hip", "femur", "tibia")
    assert leg.parents == (-1, 0, 1, 2)
    assert leg.dofs == (("tx", "ty", "tz", "rx", "ry", "rz"), (), ("rx", "rz"), ("rx",))
    assert leg.length("femur") == pytest.approx(8 * METRES)
    assert leg.metres == pytest.approx(METRES)


def test_the_motion_against_scipy(tmp_path, leg):
    scipy = pytest.importorskip("scipy.spatial.transform")
    take = load(tmp_path, leg, AMC)
    assert len(take.root) == 2
    assert torch.allclose(take.root, torch.tensor([[1.0, 2, 3], [4, 5, 6]]).double() * METRES)

    def euler(*degrees):
        return scipy.Rotation.from_euler("xyz", degrees, degrees=True)  # extrinsic: Rz·Ry·Rx

    frame = euler(30, -20, 40)
    root = euler(10, 20, 30)
    femur = root * frame * euler(40, 0, 50) * frame.inv()
    axis = euler(0, 0, 90)
    tibia = femur * axis * euler(60, 0, 0) * axis.inv()
    turned, ends = take.world
    for j, expected in enumerate((root, root, femur, tibia)):
        difference = scipy.Rotation.from_quat(turned[0, j].numpy()) * expected.inv()
        assert difference.magnitude() < 1e-9
    place = take.root[0].numpy() + root.apply([2 * METRES, 0, 0])
    assert np.allclose(ends[0, 1], place)
    place = place + femur.apply([0, -8 * METRES, 0])
    assert np.allclose(ends[0, 2], place)
    assert np.allclose(ends[0, 3], place + tibia.apply([0, -7 * METRES, 0]))


def test_a_bent_knee_turns_about_its_own_axis(tmp_path, leg):
    # The tibia's frame is turned by 90 degrees about z, so its "rx" turns about the world's y.
    take = load(tmp_path, leg, AMC)
    turned = take.rotations[1, 3]
    assert torch.allclose(
        rotations.rotate(turned, torch.tensor([0.0, 1, 0]).double()), torch.tensor([0.0, 1, 0]).double()
    )


@pytest.mark.parametrize("word", [b"rad", b"Radians"])
def test_a_skeleton_in_radians_is_the_same(tmp_path, leg, word):
    turned = ASF.replace(b"angle deg", b"angle " + word)
    for degrees in (b"30 -20 40", b"0 0 90"):
        turned = turned.replace(degrees, b" ".join(b"%.12f" % np.radians(float(x)) for x in degrees.split()))
    (tmp_path / "radians.asf").write_bytes(turned)
    said, same = (load(tmp_path, asf, AMC) for asf in (leg, read_asf(tmp_path / "radians.asf")))
    assert torch.allclose(said.rotations, same.rotations)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (b"name femur", b"name hip", "'hip' is empty or used twice"),
        (b"name femur", b"name", "'' is empty"),
        (b"     length 8\n", b"", "lacks its name, direction, length or axis"),
        (b"length 8", b"length -8", "below 0"),
        (b"length 8", b"length nan", "'nan' is not a finite number"),
        (b"direction 1 0 0", b"direction 0 0 0", "no length"),
        (b"direction 1 0 0", b"direction 1 0", "three numbers"),
        (b"length 0.45", b"length 0", "unit length of 0"),
        (b"axis 30 -20 40 XYZ", b"axis 30 -20 40 XYY", "axis order 'XYY'"),
        (b"dof rx rz", b"dof rx rx", "rx rx"),
        (b"dof rx rz", b"dof rx l", "not among rx ry rz"),
        (b"order TX", b"order TT", "root order"),
        (b"hip femur", b"hip foot", "'foot' that has no data"),
        (b"femur tibia", b"femur hip", "'hip' twice"),
        (b"    femur tibia\n", b"", "leaves out the bones tibia"),
        (b"hip femur\n", b"hip femur\n hip tibia\n", "listed twice"),
        (b"root hip", b"", "leaves out"),
    ],
)
def test_damaged_skeletons_are_refused(tmp_path, old, new, message):
    assert old in ASF
    path = tmp_path / "leg.asf"
    path.write_bytes(ASF.replace(old, new, 1))
    with pytest.raises(FormatError, match=message) as caught:
        read_asf(path)
    assert str(caught.value).startswith(str(path))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (b"\n6\n", b"\n8\n", "frame 8 follows frame 5"),
        (b"\n6\n", b"\n", "'root' with 6 values is not what"),
        (b"femur 40 50", b"femur 40", "line 6: bone 'femur' with 1 values"),
        (b"femur 40 50", b"fibula 40 50", "'fibula'"),
        (b"femur 40 50\n", b"", "line 7: frame 5 lists 2 of the skeleton's 3"),
        (b"femur 40 50\n", b"femur 40 50\nfemur 40 50\n", "line 7: bone 'femur'"),
        (b"femur 0 0\ntibia -90", b"tibia -90\nfemur 0 0", "'tibia' with 1 values is not what"),
        (b"tibia -90\n", b"", "last frame lists 2 of 3 bones"),
        (b"tibia -90", b"tibia nan", "line 11: 'nan' is not a finite number"),
        (b"tibia -90", b"tibia 1_0", "'1_0' is not a finite number"),
        (b"tibia -90", b"tibia 1e99", "beyond the limit"),
        (b"tibia -90", b"tibia \xb2", "is not a finite number"),
        (b"root 4", b"\xb2\nroot 4", "is not what"),
        (b"#!OML", b"\0", "not a text file"),
    ],
)
def test_damaged_motions_are_refused(tmp_path, leg, old, new, message):
    assert old in AMC
    with pytest.raises(FormatError, match=message) as caught:
        load(tmp_path, leg, AMC.replace(old, new, 1))
    assert str(caught.value).startswith(str(tmp_path / "a.amc"))
    assert "\n" not in str(caught.value)


def test_missing_and_empty_files(tmp_path, leg):
    with pytest.raises(InputError, match="cannot read"):
        read_asf(tmp_path / "missing.asf")
    with pytest.raises(InputError, match="cannot read"):
        read_amc(tmp_path / "missing.amc", leg)
    with pytest.raises(FormatError, match="no frame"):
        load(tmp_path, leg, b"")
    (tmp_path / "empty.asf").write_bytes(b"")
    with pytest.raises(FormatError, match="leaves out"):
        read_asf(tmp_path / "empty.asf")


def attempt(tmp_path, asf, amc):
    (tmp_path / "m.asf").write_bytes(asf)
    (tmp_path / "m.amc").write_bytes(amc)
    try:
        take = read_amc(tmp_path / "m.amc", read_asf(tmp_path / "m.asf"))
    except FormatError:
        return False
    assert torch.isfinite(take.world[1]).all()
    return True


def test_truncation_anywhere_is_noticed_or_harmless(tmp_path):
    assert attempt(tmp_path, ASF, AMC)
    for k in range(0, len(ASF), 3):
        attempt(tmp_path, ASF[:k], AMC)
    cuts = [k for k in range(len(AMC)) if attempt(tmp_path, ASF, AMC[:k])]
    # A file cut between its frames, or inside a last number, cannot be told from a whole one.
    first = AMC.index(b"tibia 60") + len(b"tibia ")
    second = AMC.index(b"6\nroot 4")
    assert all(first < k <= second or k > AMC.rindex(b" ") for k in cuts)


@settings(max_examples=200, deadline=5000, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_mutated_files_give_a_take_or_a_format_error(tmp_path, data):
    texts = [ASF, AMC]
    which = data.draw(st.integers(0, 1))
    text = texts[which]
    start = data.draw(st.integers(0, len(text)))
    stop = min(len(text), start + data.draw(st.integers(0, 30)))
    tokens = [b"begin", b"end", b"\n", b"root", b"nan", b"1e400", b":hierarchy\n", b"-", b"7"]
    middle = data.draw(st.one_of(st.binary(max_size=4), st.sampled_from(tokens), st.just(text[start:stop] * 2)))
    texts[which] = text[:start] + middle + text[stop:]
    attempt(tmp_path, *texts)


def test_a_real_take_stands_at_human_height(real_data):
    asf = read_asf(real_data / "cmu" / "subjects" / "02" / "02.asf")
    assert len(asf.bones) == 31
    assert 0.7 < asf.length("lfemur") + asf.length("ltibia") < 0.9
    take = read_amc(real_data / "cmu" / "subjects" / "02" / "02_01.amc", asf)
    assert len(take.root) == 343
    assert 0.85 < take.root[:, 1].median() < 1.05
    _, ends = take.world
    toes = ends[:, [asf.bones.index("ltoes"), asf.bones.index("rtoes")], 1]
    assert toes.min().abs() < 0.05
    assert 1.4 < ends[:, asf.bones.index("head"), 1].median() < 2.0
