"""``moveset doctor``: is everything here, whole, and how fast is it?"""

import json as jsonlib
import os
import platform
from collections.abc import Callable
from importlib import metadata
from typing import Any

import tyro

from moveset.errors import InputError

PACKAGES = (
    "torch", "numpy", "roma", "safetensors", "tokenizers", "pillow", "imageio-ffmpeg", "tyro", "tqdm"
)  # fmt: skip


def doctor(
    *, model: str = "motionpcm-small", device: str = "auto", json: tyro.conf.FlagCreatePairsOff[bool] = False
) -> int:
    """Check versions, device and weights, and time a short clip or stream. Exit code 1 if a check fails.

    Args:
        model: The model to test with: a shipped one or a model folder.
        device: auto, cpu, cuda or mps.
        json: Print one JSON object on stdout and nothing else.
    """
    checks = {
        "device": _outcome(lambda: _device(device)),
        "weights": _outcome(_weights),
        "video": _outcome(_video),
        "self_test": _outcome(lambda: _self_test(model, device)),
    }
    report: dict[str, Any] = {"versions": _versions(), "checks": checks}
    report["ok"] = all(check["ok"] for check in report["checks"].values())
    if json:
        print(jsonlib.dumps(report))
        return 0 if report["ok"] else 1
    print("  ".join(f"{name} {version}" for name, version in report["versions"].items()))
    for name, check in report["checks"].items():
        print(f"{'ok  ' if check.pop('ok') else 'FAIL'}  {name}: {', '.join(f'{k} {v}' for k, v in check.items())}")
    return 0 if report["ok"] else 1


def _outcome(check: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    # A check may fail in any way at all: to report that is what it is for.
    try:
        return {"ok": True, **check()}
    except Exception as error:
        return {
            "ok": False,
            "error": str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}",
        }


def _versions() -> dict[str, str]:
    from moveset import __version__

    versions = {"moveset": __version__, "python": platform.python_version()}
    for package in PACKAGES:
        try:
            versions[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            versions[package] = "missing"
    return versions


def _device(name: str) -> dict[str, Any]:
    import torch

    from moveset.pipelines.device import pick_device

    device = pick_device(name)
    found = torch.cuda.get_device_name(device) if device.type == "cuda" else platform.machine()
    return {"device": str(device), "name": found, "threads": torch.get_num_threads(), "cores": os.cpu_count()}


def _weights() -> dict[str, Any]:
    from moveset.io.manifest import VerifiedFolder
    from moveset.pipelines.model_folder import shipped

    folders = shipped()
    if not folders:
        raise InputError("no models are installed; reinstall moveset")
    return {f"{name} (MB verified)": round(VerifiedFolder(path).verify() / 1e6, 1) for name, path in folders.items()}


def _video() -> dict[str, Any]:
    import imageio_ffmpeg

    return {"ffmpeg": imageio_ffmpeg.get_ffmpeg_version()}


def _self_test(model: str, device: str) -> dict[str, Any]:
    from moveset.pipelines.model_config import StreamConfig
    from moveset.pipelines.model_folder import ModelFolder
    from moveset.pipelines.motion_stream import MotionStream
    from moveset.pipelines.text_to_motion import TextToMotion

    if isinstance(ModelFolder.open(model).config, StreamConfig):
        stream = MotionStream.from_pretrained(model, "a person walks forward", device=device)
        segments = [next(stream) for _ in range(2)]
        return {"frames": sum(segment.frames for segment in segments), "segment_ms": segments[1].latency_ms}
    t2m = TextToMotion.from_pretrained(model, device=device)
    cold, warm = (t2m("a person walks forward", seconds=1.0, seed=k) for k in range(2))
    if not float(warm.motion.joints[..., 1].max()) > 1.0:
        raise RuntimeError(f"the self-test's body is only {float(warm.motion.joints[..., 1].max()):.2f} m tall")
    return {"frames": len(cold.motion), **{f"{stage}_ms": ms for stage, ms in warm.timings_ms.items()}}
