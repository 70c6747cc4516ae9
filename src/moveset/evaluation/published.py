"""What the papers print: the tables of MotionPCM and RDM, as data, digit for digit.

None of these numbers was measured here, and none can be compared with one that was: other data, other evaluator, other
machine. A cell is kept as printed (``0.511±.003``); a dash is a number that the paper does not give. Numbers that
contradict each other or the text are kept too, and named in the table's notes.

Sources: MotionPCM is arXiv 2501.19083, version 1; RDM is arXiv 2406.07169.
"""

import re
from dataclasses import dataclass
from functools import cache
from typing import Any

from moveset.errors import InputError

_CELL = re.compile(r"\(?(\d+(?:\.\d+)?)(?:±(\d*\.?\d+))?\)?")


@dataclass(frozen=True)
class Number:
    """A printed number: its value, what follows the ±, and the characters themselves."""

    value: float
    interval: float | None
    printed: str

    @classmethod
    def parse(cls, cell: str) -> "Number | None":
        """A cell of a table, None for a dash.

        Raises:
            InputError: neither a number nor a dash.

        >>> Number.parse("0.511±.003")
        Number(value=0.511, interval=0.003, printed='0.511±.003')
        >>> Number.parse("–") is None
        True
        """
        if cell == "–":
            return None
        found = _CELL.fullmatch(cell)
        if not found:
            raise InputError(f"{cell!r} is neither a printed number such as 0.511±.003 nor a dash")
        return cls(float(found[1]), float(found[2]) if found[2] else None, cell)


@dataclass(frozen=True)
class PublishedRow:
    """A method and what its table says of it; ``own`` rows are of the paper's method and its ablations."""

    method: str
    numbers: dict[str, Number | None]
    own: bool


@dataclass(frozen=True)
class PublishedTable:
    """A table of a paper.

    Args:
        suite: the suite of ours that it belongs to.
        number: as the paper counts.
        dataset: what it was measured on.
        about: what it shows.
        source: paper, table and section.
        columns: names of the metrics, ours where we have them; ``time_K`` and ``flops_K`` are seconds and 1e12
            operations at K steps.
        spread: what follows the ±.
        rows: in the paper's order.
        notes: what in it is known to be wrong or in another unit.
    """

    suite: str
    number: int
    dataset: str
    about: str
    source: str
    columns: tuple[str, ...]
    spread: str
    rows: tuple[PublishedRow, ...]
    notes: tuple[str, ...]


@cache
def tables(suite: str) -> tuple[PublishedTable, ...]:
    """The tables of the paper that a suite repeats.

    Raises:
        InputError: no such suite.
    """
    found = tuple(_table(*entry) for entry in _PRINTED if entry[0] == suite)
    if not found:
        raise InputError(f"no published tables of {suite!r}; there are those of motionpcm and rdm")
    return found


def _table(
    suite: str,
    number: int,
    dataset: str,
    about: str,
    section: str,
    columns: str,
    spread: str,
    printed: str,
    *notes: str,
) -> PublishedTable:
    names = tuple(columns.split())
    rows = []
    for line in printed.strip().splitlines():
        method, after = (part.strip() for part in line.split(":"))
        cells = after.split()
        if len(cells) != len(names):
            raise InputError(f"{len(cells)} cells for {len(names)} columns in the row {method!r}")
        numbers = {name: Number.parse(cell) for name, cell in zip(names, cells, strict=True)}
        rows.append(PublishedRow(method.rstrip("*"), numbers, method.endswith("*")))
    paper = {"motionpcm": "MotionPCM (arXiv 2501.19083v1)", "rdm": "RDM (arXiv 2406.07169)"}[suite]
    source = f"{paper}, Table {number}, {section}"
    return PublishedTable(suite, number, dataset, about, source, names, spread, tuple(rows), notes)


_INTERVAL = "95 % interval of 20 repeats"
_QUALITY = "r1 r2 r3 fid mm_dist multimodality"

# An asterisk marks a paper's own rows.
_PRINTED: tuple[tuple[Any, ...], ...] = (
    (
        "motionpcm", 1, "HumanML3D", "Quality and average inference time per sentence (s)", "Section 5",
        "aits r1 r2 r3 fid mm_dist diversity multimodality", _INTERVAL,
        """
        Real: – 0.511±.003 0.703±.003 0.797±.002 0.002±.000 2.974±.008 9.503±.065 –
        Seq2Seq: – 0.180±.002 0.300±.002 0.396±.002 11.75±.035 5.529±.007 6.223±.061 –
        JL2P: – 0.246±.002 0.387±.002 0.486±.002 11.02±.046 5.296±.008 7.676±.058 –
        T2G: – 0.165±.001 0.267±.002 0.345±.002 7.664±.030 6.030±.008 6.409±.071 –
        Hier: – 0.301±.002 0.425±.002 0.552±.004 6.532±.024 5.012±.018 8.332±.042 –
        T2M: 0.038 0.457±.002 0.639±.003 0.740±.003 1.067±.020 3.340±.011 9.188±.022 2.090±.083
        TM2T: 0.760 0.424±.003 0.618±.003 0.729±.002 1.501±.017 3.467±.011 8.589±.076 2.424±.093
        MotionDiffuse: 14.74 0.491±.001 0.681±.001 0.782±.001 0.630±.011 3.113±.001 9.410±.049 1.553±.072
        MDM: 24.74 0.320±.005 0.498±.004 0.611±.007 0.544±.044 5.556±.027 9.559±.086 2.799±.072
        MLD: 0.217 0.481±.003 0.673±.003 0.772±.002 0.473±.013 3.196±.010 9.724±.082 2.413±.079
        T2M-GPT: 0.380 0.492±.003 0.679±.002 0.775±.002 0.141±.005 3.121±.009 9.722±.082 1.831±.048
        ReMoDiffuse: 0.624 0.510±.005 0.698±.006 0.795±.004 0.103±.004 2.974±.016 9.018±.075 1.795±.043
        MoMask: 0.120 0.521±.002 0.713±.002 0.807±.002 0.045±.002 2.958±.008 9.675±.068 1.241±.040
        StableMoFusion: 0.499 0.553±.003 0.748±.002 0.841±.002 0.098±.003 2.770±.006 9.748±.092 1.774±.051
        MotionCLR: 0.343 0.542±.001 0.733±.002 0.827±.003 0.099±.003 2.981±.011 9.846±.080 2.145±.043
        B2A-HDM: – 0.511±.002 0.699±.002 0.791±.002 0.084±.004 3.020±.010 9.526±.080 1.914±.078
        MotionLCM-V1 (1-step): 0.030 0.502±.003 0.701±.002 0.803±.002 0.467±.012 3.022±.009 9.631±.066 2.172±.082
        MotionLCM-V1 (2-step): 0.035 0.505±.003 0.705±.002 0.805±.002 0.368±.012 2.986±.008 9.640±.052 2.187±.094
        MotionLCM-V1 (4-step): 0.043 0.502±.003 0.698±.002 0.798±.002 0.304±.012 3.012±.007 9.607±.066 2.259±.092
        MotionLCM-V2 (1-step): 0.031 0.546±.003 0.743±.002 0.837±.002 0.072±.003 2.767±.007 9.577±.070 1.858±.056
        MotionLCM-V2 (2-step): 0.038 0.551±.003 0.745±.002 0.836±.002 0.049±.003 2.765±.008 9.584±.066 1.833±.052
        MotionLCM-V2 (4-step): 0.050 0.553±.003 0.746±.002 0.837±.002 0.056±.003 2.773±.009 9.598±.067 1.758±.056
        MotionPCM (1-step)*: 0.031 0.556±.002 0.750±.002 0.840±.002 0.054±.003 2.739±.007 9.689±.078 1.764±.074
        MotionPCM (2-step)*: 0.037 0.560±.002 0.754±.002 0.844±.002 0.040±.003 2.719±.008 9.632±.089 1.714±.069
        MotionPCM (4-step)*: 0.046 0.557±.002 0.749±.003 0.839±.002 0.036±.002 2.737±.008 9.553±.092 1.713±.067
        """,
        "Times of other methods are those of their own papers, on other machines.",
        "The MDM row is that of its first release; a correction published later raised its Top 3 to about 0.71.",
    ),
    (
        "motionpcm", 2, "HumanML3D", "Ablations of the one-step model", "Section 5.2",
        "r1 r2 r3 fid mm_dist diversity multimodality", _INTERVAL,
        """
        MotionPCM (full, 1-step)*: 0.556±.002 0.750±.002 0.840±.002 0.054±.003 2.739±.007 9.689±.078 1.764±.074
        ODE skip step k = 20*: 0.541±.001 0.738±.002 0.831±.002 0.097±.005 2.804±.006 9.744±.091 1.882±.071
        without EMA*: 0.553±.003 0.746±.002 0.836±.002 0.054±.003 2.769±.006 9.685±.087 1.774±.064
        without discriminator*: 0.547±.003 0.745±.003 0.837±.002 0.101±.006 2.785±.008 9.622±.088 1.771±.065
        """,
        "The full model uses k = 100 and an EMA of 0.95.",
    ),
    (
        "rdm", 1, "HumanML3D", "Quality", "Section 5", _QUALITY, _INTERVAL,
        """
        Real motion: 0.511±.003 0.703±.002 0.797±.003 0.002±.000 2.974±.008 –
        TEMOS: 0.424±.002 0.612±.002 0.722±.002 3.734±.028 3.703±.008 0.368±.018
        T2M: 0.457±.002 0.639±.003 0.740±.003 1.067±.002 3.340±.008 2.090±.083
        MoMask: 0.521±.002 0.713±.002 0.807±.002 0.045±.002 2.958±.008 1.241±.040
        MDM: 0.320±.005 0.498±.004 0.611±.007 0.544±.044 5.566±.027 2.799±.072
        MotionDiffuse: 0.491±.001 0.681±.001 0.782±.001 0.630±.001 3.113±.001 1.553±.042
        MLD: 0.481±.003 0.673±.003 0.772±.002 0.473±.013 3.196±.010 2.413±.079
        MotionMamba: 0.502±.003 0.693±.002 0.792±.002 0.281±.009 3.060±.058 2.294±.058
        ReMoDiffuse: 0.510±.005 0.698±.006 0.795±.004 0.103±.004 2.974±.016 1.795±.043
        Light-T2M: 0.511±.003 0.699±.002 0.795±.002 0.040±.002 3.002±.008 1.670±.061
        RDM-1*: 0.449±.001 0.661±.001 0.777±.001 0.585±.001 3.113±.001 1.538±.042
        Light-RDM-1*: 0.510±.006 0.699±.003 0.794±.002 0.07±.003 3.005±.008 1.713±.074
        AMD: – – 0.617±.014 0.586±.107 5.469±.063 2.512±.232
        CLoSD (DiP): 0.463±.006 0.668±.006 0.773±.008 0.247±.034 3.178±.025 –
        A-MDM: – – – 1.7435±.0813 – –
        MD-4: 0.339±.005 0.499±.006 0.605±.007 4.414±.116 4.338±.031 2.262±.155
        MD-7: 0.368±.002 0.546±.007 0.658±.007 3.377±.0 4.019±.03 1.771±.145
        RDM-4*: 0.442±.006 0.664±.004 0.762±.004 0.312±.016 3.604±.006 1.544±.046
        RDM-7*: 0.455±.002 0.653±.003 0.772±.002 0.272±.018 3.651±.008 1.199±.04
        """,
        "RDM-1 has the MM-Dist and most intervals of MotionDiffuse, to the last digit: probably copied.",
        "The FID intervals of T2M and MotionDiffuse are a tenth of those in MotionPCM's Table 1.",
        "The caption says that all methods use the length of the real motion; DiP's own protocol has 196 frames for "
        "every sample and a first prefix from the real motion.",
        "The MDM row is that of its first release; a correction published later raised its Top 3 to about 0.71.",
    ),
    (
        "rdm", 2, "KIT-ML", "Quality", "Section 5", _QUALITY, _INTERVAL,
        """
        Real motion: 0.5138 0.6957 0.7937 0.002±.000 2.974±.008 –
        TEMOS: 0.353±.006 0.561±.007 0.687±.005 3.717±.051 3.417±.019 0.532±.034
        T2M: 0.370±.005 0.569±.007 0.693±.007 2.770±.109 3.401±.008 1.482±.065
        MoMask: 0.433±.007 0.656±.005 0.781±.005 0.204±.011 2.779±.022 1.131±.043
        MDM: 0.164±.004 0.291±.004 0.396±.004 0.497±.021 9.191±.022 1.907±.214
        MotionDiffuse: 0.417±.004 0.621±.004 0.739±.004 1.954±.062 2.958±.005 0.730±.013
        MLD: 0.390±.008 0.609±.008 0.734±.007 0.404±.027 3.204±.027 2.192±.071
        MotionMamba: 0.419±.006 0.645±.005 0.765±.006 0.307±.041 3.021±.025 1.678±.064
        ReMoDiffuse: 0.427±.014 0.641±.004 0.765±.055 0.155±.006 2.814±.012 1.239±.028
        Light-T2M: 0.444±.006 0.670±.007 0.794±.005 0.161±.009 2.746±.016 1.005±.036
        RDM-1*: 0.381±.004 0.603±.004 0.734±.004 1.8151±.062 2.958±.005 0.693±.013
        Light-RDM-1*: 0.443±.005 0.665±.007 0.791±.005 0.299±.02 2.772±.013 1.05±.050
        MD-4: 0.3067±.007 0.4816±.007 0.6085±.007 2.8553±.073 4.1278±.026 2.9595±.086
        MD-7: 0.2728±.004 0.4528±.0059 0.5794±.005 5.5562±.085 4.5790±.03 2.4437±.1054
        RDM-4*: 0.364±.008 0.576±.008 0.712±.006 1.95±.051 3.541±.02 1.068±.045
        RDM-7*: 0.377±.005 0.5913±.003 0.715±.005 1.819±.05 3.412±.016 0.59±.038
        """,
        "The row of real motion has HumanML3D's FID and MM-Dist, and nearly its R-precision; on KIT-ML others print "
        ".424/.649/.779, .031 and 2.788.",
        "RDM-1 has the MM-Dist and most intervals of MotionDiffuse, to the last digit: probably copied.",
    ),
    (
        "rdm", 3, "KIT-ML, 196 frames, batch 128, one NVIDIA H100", "Inference time (s) and operations (10¹²)",
        "Sections 5 and 15",
        "time_10 time_50 time_100 time_200 time_1000 flops_10 flops_50 flops_100 flops_200 flops_1000",
        "standard deviation of 20 runs",
        """
        MotionDiffuse: – 2.71±0.23 4.92±.04 9.79±.08 52.07±2.06 – 64.64 128.44 256.02 1276.71
        CLoSD (DiP): 1.77±.037 8.73±.03 17.5±.09 34.87±.04 (93.18±.16) 45.89 229.44 458.88 917.76 (2617.93)
        MD-7: – 5.40±.08 11.39±.80 21.34±.09 113.20±4.63 – 83.41 165.97 331.08 1652.01
        RDM-4*: 0.21±.007 1.95±1.71 2±1.19 3.26±1.51 10.89±2.11 0.275 0.282 0.458 0.809 3.62
        RDM-7*: 0.59±.005 2.61±1.75 2.48±1.19 3.86±1.49 11.7±2.02 0.66 0.533 0.644 0.866 2.32
        RDM-14*: 0.20±.005 4.26±0.80 3.66±.06 5.2±.79 13.17±1.4 0.162 3 3.07 3.21 1.48
        """,
        "Operations mix units: those of MotionDiffuse, DiP and MD-7 are of a batch of 128, those of RDM of one segment "
        "of one sample. In equal units RDM-7's 1000 steps are 297 against MotionDiffuse's 1277: 4.3 times fewer.",
        "200 steps of RDM-14 have more operations than its 1000 steps, and RDM-7's 10 more than its 50, as printed.",
        "DiP's native number of steps is 10; its last column is in parentheses in the paper.",
    ),
    (
        "rdm", 4, "KIT-ML according to the caption", "Where the staircase of RDM-7 starts: quality",
        "Sections 12 and 15", _QUALITY, _INTERVAL,
        """
        Real motions: 0.5138 0.6957 0.7937 0.002±.000 2.974±.008 –
        Disentangle*: 0.3022±.0091 0.4954±.0084 0.6161±.0063 6.2045±.1114 4.4230±.05 1.6361±.1407
        Entangle-996*: 0.405±.002 0.593±.003 0.702±.002 0.402±.018 3.651±.008 1.199±.04
        Entangle-900*: 0.334±.012 0.537±.005 0.667±.01 3.824±.233 2.761±.019 1.284±.078
        Entangle-800*: 0.335±.005 0.539±.006 0.674±.002 3.648±.221 3.821±.06 1.241±.115
        """,
        "The real row is HumanML3D's, and Entangle-996 has the MM-Dist and MModality of RDM-7 on HumanML3D, but no "
        "other number of it: the table's data set is unclear. Only the order of its rows is of use.",
        "Entangle-996 here is Entangle-997 in Table 5; starting at the number of segments would be 993 for RDM-7.",
        "Section 12 says that an earlier start gives better quality; the table says the opposite.",
    ),
    (
        "rdm", 5, "KIT-ML, 196 frames, batch 128, one NVIDIA H100", "Where the staircase of RDM-7 starts: cost",
        "Sections 12 and 15", "time_1000 flops_1000", "standard deviation of 20 runs",
        """
        Disentangle*: 11.10±.59 2.31
        Entangle-997*: 11.7±2.02 2.32
        Entangle-900*: 13.37±.31 4.06
        Entangle-800*: 18.02±4.14 5.5
        """,
        "The paper gives the shape of a segment as 49 × 251, which is RDM-4's; RDM-7 has 28 × 251.",
        "Operations are of one sample; see Table 3.",
    ),
)  # fmt: skip
