"""The recipe "paper" against what the papers and the code they build on print: sizes and constants."""

import pytest
import torch

from moveset.models.discriminator import DiscriminatorConfig
from moveset.models.token_denoiser import TokenDenoiserConfig
from moveset.models.token_vae import TokenVAEConfig
from moveset.recipes import paper
from moveset.training.rdm import SCHEDULE

RDM, EXPORTS = paper.train_rdm(7), {export.name: export for export in paper.EXPORTS}

SIZES = {
    # MotionLCM-V2: 18.06 M; MotionPCM's teacher and student are its denoiser
    "vae": (TokenVAEConfig(), 18_056_487),
    "teacher": (TokenDenoiserConfig(), 8_237_856),
    "student": (TokenDenoiserConfig(guided=True), 8_434_464),
    "discriminator": (DiscriminatorConfig(), 9 * 132_865),
    # T2M: 21.7 M
    "evaluator": (paper.evaluator().task.model, 1_842_688 + 15_747_584 + 4_100_288),
    # MotionDiffuse: 81.2 M and 5.9 M of text; RDM-1 is it
    "motiondiffuse": (paper.train_motiondiffuse().task.model, 87_152_135),
    "rdm-1": (paper.train_rdm(1).task.model, 87_152_135),
    # Light-T2M: 4.48 M
    "light-rdm-1": (paper.train_light_rdm().task.model, 4_478_471),
    # RDM prints none
    "rdm-7": (RDM.task.model, 115_698_951),
    "flow": (RDM.task.flow, 3_816_106),
}


@pytest.mark.parametrize("name", SIZES)
def test_sizes(name):
    config, wanted = SIZES[name]
    with torch.device("meta"):
        assert sum(parameter.numel() for parameter in config.build().parameters()) == wanted


@pytest.mark.parametrize(
    ("config", "printed"),
    [
        # MotionPCM, Section 5
        (
            paper.train_pcm(1).task,
            {"points": 10, "guidance": (5.0, 15.0), "adversarial": 0.1, "ema": 0.95, "batch": 128, "lr": 2e-4},
        ),
        (paper.train_pcm(1).engine, {"steps": 384_000}),
        # MLD and MotionLCM-V2
        (paper.train_vae().task, {"kl": 1e-4, "batch": 128, "lr": 2e-4, "beta2": 0.999, "ema": 0.0}),
        (paper.train_teacher().task, {"batch": 64, "lr": 1e-4, "condition_dropout": 0.1, "normalised_latents": False}),
        # RDM, Sections 10.1 and 15
        (
            RDM.task,
            {"optimizer": "momo", "lr": 2e-4, "flow_lr": 1e-4, "batch": 512, "weight": "x0", "jacobian": 0.0,
             "noise": "white", "predict": "x0", "condition_dropout": 0.0},
        ),
        (RDM.task.flow, {"blocks": 6, "hidden": 256, "bound": "hardtanh", "log_scale": 0.1}),
        (
            RDM.task.model,
            {"layers": 8, "width": 512, "heads": 8, "text_layers": 4, "text_width": 256, "text_dim": 512, "frames": 28},
        ),
        (EXPORTS["rdm-paper"], {"sampling": {"sampler_steps": 1000, "start": 7, "eta": 1.0, "variance": "beta"}}),
        (EXPORTS["motiondiffuse-paper"], {"steps": 1000, "eta": 1.0, "variance": "posterior"}),
    ],
)  # fmt: skip
def test_constants(config, printed):
    assert {name: getattr(config, name) for name in printed} == printed


def test_the_schedule_of_rdm():
    beta = 1 - SCHEDULE.alpha_bar[1:] / SCHEDULE.alpha_bar[:-1]
    torch.testing.assert_close(beta, torch.linspace(1e-4, 0.02, 1000, dtype=torch.float64))
