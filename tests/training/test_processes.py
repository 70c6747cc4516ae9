import json

import pytest
import torch

from moveset.training import checkpoint
from tests.training.tiny_task import train
from tests.training.two_processes import Regression

pytestmark = pytest.mark.timeout(600)  # two processes that wait for each other are slow on a busy machine


@pytest.fixture(scope="module")
def both(forks, tmp_path_factory):
    """Folder of the two processes, and what each of them said."""
    folder = tmp_path_factory.mktemp("two")
    assert forks.run("tests.training.two_processes:launch", str(folder)) == 0, forks.said
    return folder, [json.loads((folder / f"rank_{rank}.json").read_text()) for rank in (0, 1)]


def test_both_processes_hold_equal_parameters(both):
    _, said = both
    assert [(one["rank"], one["world"]) for one in said] == [(0, 2), (1, 2)]
    for what in ("regression", "generator", "average"):
        assert said[0][what] == said[1][what]


def test_two_half_batches_learn_what_one_whole_batch_learns(both, tmp_path):
    alone = Regression.trained(tmp_path, 20)
    for one, together in zip(alone.net.parameters(), both[1][0]["regression"], strict=True):
        torch.testing.assert_close(one.detach().flatten(), torch.tensor(together), rtol=1e-5, atol=1e-6)


def test_replicas_of_momo_stay_equal_although_their_losses_differ(both, tmp_path):
    one, other = both[1]
    assert one["losses"] != other["losses"]
    assert one["momo"] == other["momo"]
    assert one["state"] == other["state"]
    alone = Regression.trained(tmp_path, 12, momo=True)
    parameters = torch.nn.utils.parameters_to_vector(alone.net.parameters()).tolist()
    assert parameters == pytest.approx(one["momo"], rel=1e-3, abs=1e-4)


def test_processes_draw_different_noise(both):
    assert both[1][0]["noise"] != both[1][1]["noise"]


def test_resuming_in_two_processes_is_exact(both):
    folder, said = both
    for one in said:
        for what in ("generator", "average", "noise"):
            assert one[what][0] == one[what][1]
    halves = {file.name: file.read_bytes() for file in (folder / "halves" / "step_12").iterdir()}
    assert halves == {file.name: file.read_bytes() for file in (folder / "straight" / "step_12").iterdir()}
    assert {"0/torch", "1/torch", "0/task/queue", "1/task/queue"} <= checkpoint.read_tensors(
        folder / "straight" / "step_12", "rng"
    ).keys()


def test_another_number_of_processes_resumes_with_a_warning(both):
    folder, _ = both
    with pytest.warns(UserWarning, match="settings|processes") as said:
        result = train(folder / "straight", steps=14, resume=True, validate_every=4, log_every=20, precision="32-true")
    assert result.step == 14
    assert [str(warning.message).partition(" with ")[2] for warning in said][:1] == ["other settings: steps 12 -> 14"]
    assert "written by 2 processes and is resumed by 1" in str(said[1].message)
