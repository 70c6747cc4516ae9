"""Tables of streams: each student has the guidance and the grid that it was trained for."""

from pathlib import Path
from types import SimpleNamespace

import pytest

from moveset.diffusion.phases import PhaseGrid
from moveset.errors import InputError
from moveset.training import frozen

FOLDER = Path(__file__).resolve().parents[2] / "benchmarks"


class Packed:
    """A model that has everything."""

    guidance = {"rdm": 1.0, "pcm-1": 2.5, "pcm-2": 1.0, "pcm-4": 3.0}  # noqa: RUF012

    def has(self, name):
        return True


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ([], {"rdm": 1.0, "md": 1.5, "pcm-1": 2.5, "pcm-2": 1.0, "pcm-4": 3.0}),
        (["2"], dict.fromkeys(("rdm", "md", "pcm-1", "pcm-2", "pcm-4"), 2.0)),
        (["pcm=2", "pcm-4=0"], {"rdm": 1.0, "md": 1.5, "pcm-1": 2.0, "pcm-2": 2.0, "pcm-4": 0.0}),
        (["pcm-4=0", "pcm=2", "3"], {"rdm": 3.0, "md": 3.0, "pcm-1": 2.0, "pcm-2": 2.0, "pcm-4": 0.0}),
    ],
)
def test_every_student_has_its_own_guidance(given, expected, monkeypatch):
    monkeypatch.syspath_prepend(str(FOLDER))
    from stream_quality import methods, scales

    made = methods(Packed(), [10], scales(given, Packed()), 0.0)
    assert {method.network: method.guidance for method in made} == expected


def test_guidance_of_nobody_is_refused(monkeypatch):
    monkeypatch.syspath_prepend(str(FOLDER))
    from stream_quality import scales

    with pytest.raises(InputError, match="'pcm-3' is none of rdm, md, pcm"):
        scales(["pcm-3=1"], Packed())


def test_students_of_runs_are_asked_on_their_own_grids(monkeypatch):
    monkeypatch.syspath_prepend(str(FOLDER))
    from stream_models import Method, Networks

    asked = []
    loaded = SimpleNamespace(task={"points": 20}, path=Path("step_1"), module=object())
    monkeypatch.setattr(frozen, "load", lambda *given, **more: asked.append(given) or loaded)
    networks = Networks(Path("runs"), folders={"pcm-4": "four"})
    assert networks.levels(Method(network="pcm-4", steps=4)) == PhaseGrid(20, 4).edges[::-1]
    assert networks.module("pcm-4") is loaded.module
    assert asked == [(Path("runs/four"), "student_ema")]
