"""What a measurement was made on, and the memory of this process. Nothing here tells whose machine it is."""

import os
import platform
import sys
from importlib import metadata
from pathlib import Path
from typing import Any

from moveset.io.process import cores


def describe_machine() -> dict[str, Any]:
    """Processor, cores that may be used, versions, threads and load, for JSON."""
    import torch

    return {
        "cpu": cpu_name(),
        "cores": cores(),
        "system": platform.system(),
        "python": platform.python_version(),
        "torch": metadata.version("torch"),
        "threads": torch.get_num_threads(),
        "waiting": os.environ.get("OMP_WAIT_POLICY", "default").lower(),
        "gpu": torch.cuda.get_device_name() if torch.cuda.is_available() else None,
    }


def cpu_name() -> str:
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.is_file() else []
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), platform.machine())


def load() -> float | None:
    """Processes that want to run, on average over the last minute; None where the system does not tell."""
    return round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None


def peak_mb() -> float:
    """The most memory (MB, resident) that this process has held."""
    status = Path("/proc/self/status")
    if status.is_file():
        # Linux's ru_maxrss begins with what the process that started this one held.
        line = next(line for line in status.read_text().splitlines() if line.startswith("VmHWM"))
        return int(line.split()[1]) * 1.024e-3
    import resource

    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit * 1e-6


def resident_mb() -> float:
    """The memory (MB, resident) that this process holds now; where the system does not tell, the most it has held."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") * 1e-6
    except OSError:
        return peak_mb()
