"""The C# of docs/integrations.md compiles, and its body stands in Unity's axes where moveset's does.

Runs where Mono's compiler is at hand, against a stand-in for the few types of UnityEngine that it uses.
"""

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import torch

from moveset.io.packets import pack_packet
from tests.motions import wander

ROOT = Path(__file__).resolve().parents[2]


def test_the_unity_snippet_poses_a_body(tmp_path):
    if not (shutil.which("mcs") and shutil.which("mono")):
        pytest.skip("no C# compiler here: install mono-mcs and mono-runtime")
    page = (ROOT / "docs" / "integrations.md").read_text()
    (tmp_path / "Snippet.cs").write_text(re.search(r"```csharp\n(.*?)```", page, re.DOTALL)[1])
    stub = Path(__file__).with_name("unity_stub.cs")
    built = subprocess.run(
        ["mcs", f"-out:{tmp_path / 'a.exe'}", str(stub), str(tmp_path / "Snippet.cs")],
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert built.returncode == 0, built.stdout + built.stderr

    motion = wander(6, seed=4, bend=0.7, turn=1.0)
    planted = torch.ones(6, 4, dtype=torch.bool)
    (tmp_path / "p.mvst").write_bytes(pack_packet(motion, first_frame=56, planted=planted))
    body = motion.skeleton
    rows = zip(body.joints, body.parents, body.offsets.tolist(), strict=True)
    (tmp_path / "s.txt").write_text("\n".join(f"{n} {p} {o[0]:.8f} {o[1]:.8f} {o[2]:.8f}" for n, p, o in rows))
    run = ["mono", str(tmp_path / "a.exe"), str(tmp_path / "p.mvst"), str(tmp_path / "s.txt"), "0", "2.5", "5"]
    done = subprocess.run(run, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    head, *lines = done.stdout.splitlines()
    assert head.split() == ["56", "20", "6"]
    seen = np.array([line.split() for line in lines], dtype=np.float64).reshape(3, 22, 3)
    half = motion.resampled(40.0)
    wanted = half.joints[[0, 5, 10]].numpy() * (-1, 1, 1)
    assert np.abs(seen - wanted).max() < 1e-5

    (tmp_path / "p.mvst").write_bytes(b"MVSU" + bytes(60))
    refused = subprocess.run(run, capture_output=True, text=True, timeout=120, check=False)
    assert "no packet of version 1" in refused.stderr
