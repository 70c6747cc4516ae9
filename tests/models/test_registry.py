import dataclasses
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from torch import nn

from moveset.errors import FormatError, InputError
from moveset.models import registry
from moveset.models.registry import ModelConfig, build_model, describe, parse_config, register, require_range


@dataclasses.dataclass(frozen=True, kw_only=True, slots=True)
class ToyConfig(ModelConfig):
    size: int
    rate: float = 0.5
    names: tuple[str, ...] = ()
    limit: int | None = None
    on: bool = False

    def __post_init__(self) -> None:
        require_range("size", self.size, 1, 64)


def toy(config: ToyConfig) -> nn.Module:
    module = nn.Linear(config.size, 1)
    module.config = config
    return module


@pytest.fixture(autouse=True)
def _toy(monkeypatch):
    monkeypatch.setattr(registry, "_KINDS", dict(registry._KINDS))
    register("toy", ToyConfig, toy)


def test_importing_the_package_makes_every_kind_known():
    files = Path(registry.__file__).parent.glob("*.py")
    registered = {kind for file in files for kind in re.findall(r'^register\("(\w+)"', file.read_text(), re.MULTILINE)}
    code = "from moveset.models.registry import kinds; print(*kinds())"
    known = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=300).stdout
    assert set(known.split()) == registered


def test_a_configuration_survives_json():
    config = ToyConfig(size=3, rate=0.25, names=("a", "b"), limit=7, on=True)
    kind, stored = describe(config)
    assert build_model(kind, json.loads(json.dumps(stored))).config == config


def test_whole_numbers_are_fine_for_floats_and_null_for_optional():
    assert parse_config("toy", {"size": 3, "rate": 1, "limit": None}) == ToyConfig(size=3, rate=1.0)


@pytest.mark.parametrize(
    ("kind", "config", "named"),
    [
        ("os.system", {}, "os.system"),
        ("toy", {"size": 3, "__class__": "x"}, "__class__"),
        ("toy", {}, "size"),
        ("toy", {"size": "3"}, "toy.size"),
        ("toy", {"size": True}, "toy.size"),
        ("toy", {"size": 3.0}, "toy.size"),
        ("toy", {"size": 3, "rate": "1"}, "toy.rate"),
        ("toy", {"size": 3, "names": [1]}, "toy.names"),
        ("toy", {"size": 3, "names": "ab"}, "toy.names"),
        ("toy", {"size": 3, "limit": 1.5}, "toy.limit"),
        ("toy", {"size": 10**12}, "1000000000000"),
        ("toy", [1], "object"),
    ],
)
def test_damaged_configurations_are_refused_by_name(kind, config, named):
    with pytest.raises(FormatError, match=named.replace(".", r"\.")) as caught:
        build_model(kind, config)
    assert "\n" not in str(caught.value)


def test_nan_is_out_of_range():
    with pytest.raises(InputError):
        require_range("rate", float("nan"), 0, 1)


def test_kinds_are_unique():
    with pytest.raises(ValueError, match="already"):
        register("toy", ToyConfig, toy)
