import json
import math
from pathlib import Path

import pytest
import torch

from moveset.errors import MovesetError
from moveset.training.log import TrainingLog, truncate_metrics


def lines(folder):
    return [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]


def test_resuming_drops_what_came_later_and_a_torn_line(tmp_path):
    file = tmp_path / "metrics.jsonl"
    whole = [json.dumps({"step": step, "x": step / 3}) for step in (1, 2, 3, 3, 4)]
    file.write_text("\n".join(whole) + '\n{"step": 2, "x": 0.')
    truncate_metrics(file, 3)
    assert file.read_text().splitlines() == whole[:4]
    truncate_metrics(tmp_path / "absent.jsonl", 3)
    assert [item.name for item in tmp_path.iterdir()] == ["metrics.jsonl"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no full device")
def test_a_full_disk_is_one_sentence_that_names_the_file(tmp_path):
    with TrainingLog(tmp_path, "t", 0, 1, tensorboard=False) as log:
        log._file.close()
        log._file = open("/dev/full", "ab", buffering=0)  # noqa: SIM115 (closed by the log)
        with pytest.raises(MovesetError, match=r"/dev/full could not be written \(No space left on device\)"):
            log.write("train", 1, {"loss": 1.0})


def test_means_are_those_since_the_last_line(tmp_path):
    with TrainingLog(tmp_path, "t", 0, 4, tensorboard=False) as log:
        for step in range(1, 5):
            log.add(
                {
                    "tensor": torch.tensor(float(step), requires_grad=True),
                    "number": 10 * step,
                    "half": torch.ones((), dtype=torch.bfloat16),
                }
            )
            if step % 2 == 0:
                log.flush(step, lr=1 / step)
        assert log.flush(4) == {}
    assert [(x["step"], x["tensor"], x["number"], x["half"], x["lr"]) for x in lines(tmp_path)] == [
        (2, 1.5, 15, 1, 0.5),
        (4, 3.5, 35, 1, 0.25),
    ]
    assert all(x["steps_per_second"] > 0 and x["split"] == "train" for x in lines(tmp_path))


@pytest.mark.parametrize("value", [math.nan, math.inf, torch.tensor(-math.inf)])
def test_a_metric_that_is_not_finite_stops(tmp_path, value):
    with TrainingLog(tmp_path, "t", 0, 2, tensorboard=False) as log:
        log.add({"loss": 1.0}), log.add({"loss": value})
        with pytest.raises(MovesetError, match=r"loss became .* by step 2"):
            log.flush(2)


def test_a_validation_without_a_value_is_null(tmp_path):
    with TrainingLog(tmp_path, "t", 0, 2, tensorboard=False) as log:
        log.write("val", 1, {"correlation": math.nan, "mse": 0.5})
    assert lines(tmp_path)[0]["correlation"] is None


def test_no_bar_where_nobody_looks(tmp_path, capsys):
    with TrainingLog(tmp_path, "t", 0, 2, tensorboard=False) as log:
        log.add({"loss": 1.0})
    assert capsys.readouterr() == ("", "")
