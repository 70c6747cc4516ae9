"""Laws of files: through whatever format a motion passes, it is the same; and whatever a file holds, it is judged."""

import runpy
import sys
from itertools import cycle, product
from pathlib import Path

import pytest

from moveset.io import load, save
from moveset.motion.retarget import retarget
from moveset.motion.rigs import RIGS
from tests.motions import wander

FORMATS = (".bvh", ".glb", ".gltf", ".vrma", ".npz", ".amass.npz", ".html")
BODIES = {".vrma": "vrm", ".amass.npz": "hml22"}  # formats of one skeleton, to which others are retargeted
RATES = (20.0, 24.0, 30.0, 60.0, 120.0)


@pytest.fixture(scope="module")
def motions():
    """Nine frames at every rate on every skeleton."""
    made = {fps: wander(9, seed=6, fps=fps, turn=1.0) for fps in RATES}
    return {(rig, fps): retarget(made[fps], rig) for rig, fps in product(RIGS, RATES)}


def distance(found, wanted):
    """Farthest that a joint is from where it should be at any frame, joints by name."""
    order = [found.skeleton.joints.index(joint) for joint in wanted.skeleton.joints]
    return float((found.joints[:, order] - wanted.joints).abs().max())


@pytest.mark.parametrize("rig", RIGS)
@pytest.mark.parametrize("suffix", FORMATS)
def test_written_and_read_a_motion_is_the_same(motions, suffix, rig, tmp_path):
    """At two of the rates for each skeleton, so at all of them for each format."""
    turn = list(RIGS).index(rig)
    for fps in (RATES[turn % 5], RATES[(turn + 2) % 5]):
        made = motions[rig, fps]
        wanted = retarget(made, BODIES[suffix]) if suffix in BODIES else made
        found = load(save(made, tmp_path / f"a{suffix}"))
        assert (len(found), found.fps) == (len(wanted), fps)
        assert distance(found, wanted) < 1e-4, fps


PAIRS = [pair for pair in product(FORMATS, FORMATS) if pair[0] != pair[1]]


@pytest.mark.parametrize(("pair", "rig", "fps"), [*zip(PAIRS, cycle(RIGS), cycle(RATES), strict=False)])
def test_it_is_the_same_through_every_pair_of_formats(motions, pair, rig, fps, tmp_path):
    """Skeletons and rates take turns: 6 and 5 of them over 42 pairs."""
    first = load(save(motions[rig, fps], tmp_path / f"a{pair[0]}"))
    second = load(save(first, tmp_path / f"b{pair[1]}"))
    wanted = retarget(first, BODIES[pair[1]]) if pair[1] in BODIES else first
    assert (len(second), second.fps) == (9, fps)
    assert distance(second, wanted) < 1e-4


FUZZ = Path(__file__).resolve().parents[2] / "benchmarks" / "fuzz_readers.py"


@pytest.fixture(scope="module")
def program():
    sys.path.insert(0, str(FUZZ.parent))
    try:
        return runpy.run_path(str(FUZZ))
    finally:
        sys.path.remove(str(FUZZ.parent))


@pytest.mark.parametrize("name", ["a.bvh", "a.glb", "a.gltf", "a.vrma", "a.npz", "a.amass.npz", "a.npy", "a.html"])
def test_changed_files_are_read_or_refused(program, name):
    assert name in program["READERS"]
    tally = program["fuzz"](name, 60, seed=1)
    assert tally.faults == []
    assert tally.read + tally.refused == tally.mutants == 60
    assert min(tally.read, tally.refused) > 0


def test_what_is_no_sentence_is_a_fault(program, monkeypatch):
    """The program notices an exception of another kind, and a reader that takes its time."""

    def spin(path):
        while True:
            pass

    kept = []
    names = program["fuzz"].__globals__
    monkeypatch.setitem(names, "load", lambda path: 1 / 0)
    tally = program["fuzz"]("a.npz", 2, seed=1, keep=lambda number, data: kept.append(number))
    assert [fault.split(": ")[1] for fault in tally.faults] == ["ZeroDivisionError"] * 2
    monkeypatch.setitem(names, "load", spin)
    monkeypatch.setitem(names, "SECONDS", 0.05)
    assert "_TooSlow" in program["fuzz"]("a.npz", 1, seed=1).faults[0]
    assert kept == [0, 1]
