"""Result files as an evaluation writes them, with numbers that a test chooses."""

import json
from collections.abc import Mapping
from pathlib import Path

Numbers = Mapping[str, tuple[float, float | None]]


def result_json(numbers: Numbers, *, repeats: int = 20, seconds: float = 0.02, **changed: object) -> dict:
    """A result with these means and half widths; ``seconds`` an item."""
    return {
        "model": "m", "network": "n", "steps": 1,
        "settings": {}, "protocol": {"split": "test", "group": 32, "seed": 0},
        "items": 320, "distinct_texts": 300, "labels": 90,
        "evaluator": {"name": "t2m-small", "sha256": "e" * 64},
        "data": {"name": "corpus.safetensors", "sha256": "d" * 64},
        "weights_sha256": "a" * 64, "commit": "c0ffee", "date": "2026-01-02",
        "repeats": [{name: mean for name, (mean, _) in numbers.items()}] * repeats,
        "metrics": {name: {"mean": mean, "interval": half} for name, (mean, half) in numbers.items()},
        "seconds_per_item": seconds, "versions": {},
        **changed,
    }  # fmt: skip


def suite_folder(path: Path, suite: str, results: Mapping[str, dict]) -> Path:
    """A suite's results folder with these results, below ``path``."""
    folder = path / suite
    folder.mkdir(parents=True, exist_ok=True)
    for key, result in results.items():
        (folder / f"{key}.json").write_text(json.dumps(result))
    return folder
