"""``moveset models``: what comes with this installation."""

import json as jsonlib
from pathlib import Path
from typing import Any

import tyro

from moveset.pipelines.role import Role, named


def models(*, json: tyro.conf.FlagCreatePairsOff[bool] = False) -> int:
    """List the shipped models and their networks.

    Args:
        json: Print one JSON object on stdout and nothing else.
    """
    from moveset.pipelines.model_folder import shipped

    rows = [describe(name, path) for name, path in shipped().items()]
    if json:
        print(jsonlib.dumps({"models": rows}))
        return 0
    if not rows:
        print("no models are installed; reinstall moveset, or give a model folder with --model")
    for row in rows:
        tell(row)
    return 0


def describe(name: str, path: Path) -> dict[str, Any]:
    """What a shipped model is and can, as a JSON object."""
    from moveset.pipelines.model_config import DEFAULT_MODEL, DEFAULT_STREAM, StreamConfig
    from moveset.pipelines.model_folder import ModelFolder

    folder = ModelFolder.open(path)
    config = folder.config
    if isinstance(config, StreamConfig):
        limits: dict[str, Any] = {"network": config.network, "segment_seconds": config.segment / config.fps}
    else:
        limits = {
            "lcm_steps": list(config.steps("lcm")),
            "teacher": "teacher" in config.models,
            "max_seconds": config.max_frames / config.fps,
        }
    return {
        "name": name,
        "task": config.task,
        "default": name in (DEFAULT_MODEL, DEFAULT_STREAM),
        "megabytes": round(sum(size for _, size in folder.files.values()) / 1e6, 1),
        "networks": {
            network: {
                "kind": spec.kind,
                "megabytes": round(folder.files[f"{network}.safetensors"][1] / 1e6, 1),
                "base": spec.base,
            }
            for network, spec in config.models.items()
        },
        "pcm_steps": list(config.steps("pcm")),
        **limits,
        "fps": config.fps,
        "text_encoder": config.text_encoder,
        "guidance": dict(config.guidance),
        "provenance": dict(config.provenance),
    }


def tell(row: dict[str, Any]) -> None:
    """Print a model for a person."""
    steps = "/".join(map(str, row["pcm_steps"]))
    if "network" in row:
        makers = (name for name in row["networks"] if named(name).role not in (Role.FLOW, Role.SIDES))
        others = ", ".join(name for name in makers if name != row["network"])
        can = f"a stream by {row['network']}" + f", or by {others}" * bool(others)
        limits = f"{row['segment_seconds']:g} s a segment"
    else:
        can = f"MotionPCM in {steps} steps" + (", LCM" if row["lcm_steps"] else "") + ", teacher" * row["teacher"]
        limits = f"up to {row['max_seconds']:g} s a prompt"
    print(f"{row['name']}  {row['megabytes']} MB  {can}  {row['fps']:g} fps  {limits}")
    print("    " + ", ".join(f"{network} {entry['megabytes']} MB" for network, entry in row["networks"].items()))
    if based := [network for network, entry in row["networks"].items() if entry["base"]]:
        print(f"    {', '.join(based)}: kept as differences from {row['networks'][based[0]]['base']}")
    for key, value in row["provenance"].items():
        print(f"    {key}: {value}")
