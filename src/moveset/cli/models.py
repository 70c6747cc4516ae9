"""``moveset models``: what comes with this installation."""

import json as jsonlib

import tyro


def models(*, json: tyro.conf.FlagCreatePairsOff[bool] = False) -> int:
    """List the shipped models.

    Args:
        json: Print one JSON object on stdout and nothing else.
    """
    from moveset.pipelines.bundle import DEFAULT_MODEL, Bundle, shipped

    rows = []
    for name, path in shipped().items():
        bundle = Bundle(path)
        config = bundle.config
        rows.append(
            {
                "name": name,
                "default": name == DEFAULT_MODEL,
                "megabytes": round(sum(size for _, size in bundle.files.values()) / 1e6, 1),
                "pcm_steps": list(config.steps("pcm")),
                "lcm_steps": list(config.steps("lcm")),
                "teacher": "teacher" in config.models,
                "fps": config.fps,
                "max_seconds": config.max_frames / config.fps,
                "text_encoder": config.text_encoder,
                "guidance": dict(config.guidance),
                "provenance": dict(config.provenance),
            }
        )
    if json:
        print(jsonlib.dumps({"models": rows}))
        return 0
    if not rows:
        print("no models are installed; reinstall moveset, or give a model folder with --model")
    for row in rows:
        steps = "/".join(map(str, row["pcm_steps"]))
        solvers = f"MotionPCM in {steps} steps" + (", LCM" if row["lcm_steps"] else "") + ", teacher" * row["teacher"]
        limits = f"{row['fps']:g} fps  up to {row['max_seconds']:g} s a prompt"
        print(f"{row['name']}  {row['megabytes']} MB  {solvers}  {limits}")
        for key, value in row["provenance"].items():
            print(f"    {key}: {value}")
    return 0
