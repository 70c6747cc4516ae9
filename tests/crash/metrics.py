import json
from pathlib import Path


def logged_step(folder: Path) -> int:
    """The last step of which a whole line is in ``metrics.jsonl``; 0 if there is none."""
    file = folder / "metrics.jsonl"
    lines = file.read_text().split("\n")[:-1] if file.exists() else []
    return max((json.loads(line)["step"] for line in lines), default=0)
