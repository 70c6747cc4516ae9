"""Reads pip's plan for torch on stdin and stops a download of several GB of CUDA libraries that nobody asked for."""

import json
import platform
import sys

plan = json.load(sys.stdin)["install"]
version = plan[0]["metadata"]["version"] if plan else "+cpu"  # nothing to install: it is there already
if "+cpu" not in version and (platform.system(), platform.machine()) == ("Linux", "x86_64"):
    sys.exit(
        f"pip would install torch {version} with CUDA (several GB); run make with TORCH_INDEX set to PyTorch's index "
        "of CPU wheels (see 'Start Locally' on pytorch.org), or with ANY_TORCH=1 to take that build"
    )
