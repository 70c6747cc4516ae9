"""RDM as published: what its training, its flow and its sampler are worth, in FID and R@3 against network calls.

    python benchmarks/rdm_grid.py --corpus data/corpus.safetensors --out runs/rdm-grid
    python benchmarks/rdm_grid.py --out runs/rdm-grid --plot        # the pictures alone, from what is there

Every variant is trained with every seed for the same steps, exported, and sampled on val at every point: K = 1000 with
both variances and DDIM, from every start R, in both shapes of the staircase. All of it can be stopped and called again:
trainings go on where they were, and a point whose result is there is skipped. Several processes may share the work by
``--variants`` and ``--first-seed``. OUT has ``runs``, ``models`` and ``points``; ``curves.json`` has means over seeds
with Student's 95 % intervals and every seed's values, ``curves-fid.svg`` and ``curves-r3.svg`` are drawn from it.
"""

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from arguments import Parser, at_least, write_report
from moveset.cli.tables import state_now
from moveset.data.dataset import open_for_training
from moveset.data.segments import SEGMENT_FRAMES
from moveset.errors import InputError, exit_code_of
from moveset.evaluation.evaluator import DEFAULT_EVALUATOR
from moveset.evaluation.intervals import Interval
from moveset.evaluation.plots import COLOURS, STYLE
from moveset.evaluation.protocol import Protocol
from moveset.evaluation.run import EvaluationConfig, evaluate
from moveset.io.limits import atomic_write
from moveset.io.manifest import json_object
from moveset.rdm.staircase import Staircase
from moveset.training.engine import run
from moveset.training.export import StreamExport, export
from moveset.training.tasks import RECIPES, Sources, load_recipe, task_maker, with_settings

N = 7
LATE = (N, 100, 500, 900, 1000)  # R at K = 1000: the paper's Entangle-993 (it prints 996 and 997), -900, …
STEPS = (10, 50, 100, 1000)
METRICS = ("fid", "r1", "r2", "r3", "mm_dist", "diversity", "jerk", "boundary_jerk")


@dataclass(frozen=True, kw_only=True)
class Variant:
    """A training of the grid.

    Args:
        what: as for ``moveset train``.
        settings: that differ from the recipe's.
        base: the variant that it is another of, and is compared with.
        teacher: the variant that a student learns from.
    """

    what: str = "rdm-7"
    settings: tuple[str, ...] = ()
    base: str = ""
    teacher: str = ""

    @property
    def network(self) -> str:
        """In the exported folder."""
        return f"pcm-{self.settings[-1].removeprefix('phases=')}" if self.teacher else "rdm"

    @property
    def overlaps(self) -> bool:
        """Whether segments are sampled by a staircase, not one after the other; students are by both."""
        return self.what == "rdm-7"


# Aligned as published, and told of no sides, which nothing here reads off a sentence.
ALIGNED = ("cutting.aligned=true", "sides=0", "side_weight=0")
NUMBERED = (*ALIGNED, f"model.max_index={N - 1}")
# Powers of the flow up to the last segment's, as published; its capacity is the recipe's.
FLOW = (f"depth_cap={N - 1}", f"flow.max_index={N - 1}", "flow.bound=hardtanh")
PUBLISHED = ("flow.blocks=6", "flow.hidden=256")
IDENTITY = ("flow=null",)
ENTANGLED = ("grid.entangled=0.5",)
ALGORITHM_2 = ("grid.anchor=first", "grid.share_noise=true", "grid.condition=previous")
# Eq. 13 and 31 weigh by 1 / |det|, which overflows for 28 frames of 269 features: here its mean for a number of them.
JOINT = ("joint=true", "weight=x0", f"jacobian={1 / (SEGMENT_FRAMES[N] * 269):.3g}")
# What tells noisy pasts in another way goes.
OVERLAPPING = ("overlapping=true", "context_noise_rollout=false")
BARE = ("heading_change=0", "heading_noise=0", "model.heading_change=false")

VARIANTS = {
    "printed": Variant(base="anchored", settings=(*NUMBERED, *FLOW, *ALGORITHM_2)),
    "anchored": Variant(settings=(*NUMBERED, *FLOW)),
    "anchored-identity": Variant(base="anchored", settings=(*NUMBERED, *IDENTITY)),
    "entangled": Variant(base="anchored", settings=(*NUMBERED, *FLOW, *ENTANGLED)),
    # Joint training of no flow is this.
    "entangled-identity": Variant(base="entangled", settings=(*NUMBERED, *IDENTITY, *ENTANGLED)),
    "joint": Variant(base="entangled", settings=(*NUMBERED, *FLOW, *ENTANGLED, *JOINT)),
    "entangled-published": Variant(base="entangled", settings=(*NUMBERED, *FLOW, *ENTANGLED, *PUBLISHED)),
    "entangled-free": Variant(
        base="entangled", settings=(*NUMBERED, *FLOW, *ENTANGLED, *PUBLISHED, "flow.log_scale=1.0")
    ),
    # What one of RDM-7 and MD-7 is told or both are: the course; the past.
    "anchored-bare": Variant(base="anchored", settings=(*NUMBERED, *FLOW, *BARE)),
    "md": Variant(base="anchored", what="md-7", settings=NUMBERED),
    "md-bare": Variant(base="md", what="md-7", settings=(*NUMBERED, *BARE)),
    "md-alone": Variant(base="md", what="md-7", settings=(*NUMBERED, "md_condition=none")),
    # Few evaluations a segment, told a finished past, in the coordinates of the teacher's flow or of none.
    **{
        f"{teacher}-pcm-{k}": Variant(what="rdm-student", teacher=teacher, settings=(*ALIGNED, f"phases={k}"))
        for teacher in ("entangled", "entangled-identity")
        for k in (1, 2, 4)
    },
    # The same, taught with the segment before as a staircase has it; in one evaluation it is finished.
    **{
        f"{teacher}-pcm-{k}-overlapping": Variant(
            what="rdm-student", base=f"{teacher}-pcm-{k}", teacher=teacher,
            settings=(*ALIGNED, *OVERLAPPING, f"phases={k}"),
        )
        for teacher in ("entangled", "entangled-identity")
        for k in (2, 4)
    },
}  # fmt: skip


@dataclass(frozen=True)
class Point:
    """How a trained variant is sampled: K steps, of which a later segment takes R."""

    steps: int
    start: int
    shape: str = "parallelogram"
    variance: str = ""  # of DDPM; "" is DDIM
    overlapping: bool = False  # of a student

    @property
    def name(self) -> str:
        """In files."""
        more = [self.variance] * bool(self.variance) + ["overlapping"] * self.overlapping
        return "-".join([f"K{self.steps}", f"R{self.start}", self.shape, *more])

    def settings(self, variant: Variant) -> dict[str, Any]:
        """Of the sampler; a student's levels and start are its own."""
        if variant.teacher:
            return {"lag": 1} if self.overlapping else {}
        fresh = {"eta": 1.0, "variance": self.variance} if self.variance else {"eta": 0.0}
        return {"start": self.start, "lag": 1 if variant.overlaps else self.steps, "shape": self.shape, **fresh}


def points(variant: Variant, steps: Sequence[int], late: Sequence[int] = LATE) -> Iterator[Point]:
    """Those of a variant at these K, and R of K = 1000; a student has its own, and what it makes by a staircase."""
    if variant.teacher:
        count = int(variant.network.removeprefix("pcm-"))
        yield Point(count, count)
        if count > 1:
            yield Point(count, count, overlapping=True)
        return
    for k in steps:
        variances = ("posterior", "beta") if k == 1000 else ("",)
        if not variant.overlaps:
            yield from (Point(k, k, variance=variance) for variance in variances)
            continue
        starts = sorted(set(late if k == 1000 else (min(N, k), max(1, k // 2), k)))
        yield from (Point(k, r, "triangle", variance) for variance in variances for r in starts)
        yield from (Point(k, r, "parallelogram", variances[0]) for r in starts)


def trained(name: str, seed: int, given: argparse.Namespace) -> Path:
    """The model folder of a variant, made if it is not there.

    Raises:
        KeyboardInterrupt: the training was stopped; its checkpoint is there.
    """
    out, variant = given.out, VARIANTS[name]
    folder = out / "models" / f"{name}.{seed}"
    if (folder / "config.json").is_file():
        return folder
    recipe, runs = load_recipe(given.recipe, variant.what), out / "runs"
    more = () if variant.teacher else given.set
    config = with_settings(recipe.task, (*variant.settings, *more))
    asked = given.student_steps if variant.teacher else given.train_steps
    steps = recipe.engine.steps if asked is None else asked
    engine = replace(recipe.engine, seed=seed, device=given.device, steps=steps)
    teacher = runs / f"{variant.teacher}.{seed}"
    sources = Sources(corpus=given.corpus, vae=runs / "vae", teacher=teacher, cache=out / "cache")
    if variant.teacher:
        trained(variant.teacher, seed, given)
    print(f"rdm_grid: training {name}, seed {seed}", file=sys.stderr, flush=True)
    if run(task_maker(variant.what, config, sources), engine, runs / folder.name, True).stopped_by:
        raise KeyboardInterrupt
    networks = {"rdm": teacher.name, variant.network: folder.name} if variant.teacher else {"rdm": folder.name}
    sampling = {"sampler_steps": 10, "start": 10, "lag": 10}
    # Without guidance, as published: a call is one evaluation.
    guidance = dict.fromkeys(networks, 0.0)
    what = StreamExport(name=folder.name, runs=networks, guidance=guidance, sampling=sampling)
    return export(what, open_for_training(given.corpus), runs, out / "cache", folder)


def measure(name: str, seed: int, point: Point, given: argparse.Namespace) -> None:
    """The result of a point, in ``points``, if it is not there."""
    variant, key = VARIANTS[name], f"{name}.{seed}.{point.name}"
    if (given.out / "points" / f"{key}.json").is_file():
        return
    print(f"rdm_grid: measuring {key}", file=sys.stderr, flush=True)
    config = replace(
        common(given), model=str(given.out / "models" / f"{name}.{seed}"), network=variant.network, steps=point.steps,
        settings=tuple(point.settings(variant).items()), name=key,
    )  # fmt: skip
    evaluate(config, given.out / "points", processes=given.repeats)


def common(given: argparse.Namespace) -> EvaluationConfig:
    """How all points are measured."""
    protocol = Protocol(split="val", repeats=given.repeats, multimodality=0)
    return EvaluationConfig(
        data=given.corpus, evaluator=given.evaluator, protocol=protocol, items=given.items, device=given.device
    )


def gather(out: Path) -> dict[str, Any]:
    """All points that are there: means over seeds with intervals, in the order of the grid. Paired by seeds:
    ``minus_whole`` is what a late start makes of R = K, ``minus_base`` what a training makes of that of its base.

    Raises:
        InputError: there is none.
    """
    rows: dict[tuple, dict[int, dict[str, float]]] = {}
    for path in sorted((out / "points").glob("*.json")):
        name, seed, _ = path.stem.split(".")
        result = json_object(path.read_bytes(), path, "delete it, and it is measured again")
        said = result["settings"]
        variance = said.get("variance", "posterior") if said["eta"] else ""
        key = (name, result["steps"], said["start"], said["lag"], said["shape"], variance)
        metrics = {metric: result["metrics"][metric]["mean"] for metric in METRICS if metric in result["metrics"]}
        rows.setdefault(key, {})[int(seed)] = metrics
    if not rows:
        raise InputError(f"{out} has no points; leave --plot out to make them")
    order = list(VARIANTS)
    curves = []
    for key in sorted(rows, key=lambda key: (order.index(key[0]), *key[1:])):
        name, steps, start, lag, shape, variance = key
        seeds = dict(sorted(rows[key].items()))
        whole = rows.get((name, steps, steps, lag, shape, variance), {})
        base = VARIANTS[name].base
        base_lag = 1 if not base or VARIANTS[base].overlaps else steps
        if VARIANTS[name].teacher:  # as its base, by a staircase and without
            base_lag = lag
        first = next(iter(seeds.values()))
        curves.append(
            {
                "variant": name, "base": base, "K": steps, "R": start, "lag": lag, "shape": shape, "variance": variance,
                "calls": sum(map(len, Staircase(steps, N, start, shape, lag).wavefront())),
                "metrics": {metric: Interval.of([one[metric] for one in seeds.values()]).to_json() for metric in first},
                "minus_whole": _paired(seeds, whole if start < steps else {}),
                "minus_base": _paired(seeds, rows.get((base, steps, start, base_lag, shape, variance), {})),
                "seeds": seeds,
            }
        )  # fmt: skip
    return {"state": json_object((out / "state.json").read_bytes(), out / "state.json"), "curves": curves}


def _paired(seeds: dict[int, dict[str, float]], base: dict[int, dict[str, float]]) -> dict[str, Any]:
    both = [seed for seed in seeds if seed in base]
    metrics = seeds[both[0]] if both else ()
    return {metric: Interval.of([seeds[s][metric] - base[s][metric] for s in both]).to_json() for metric in metrics}


def draw(found: dict[str, Any], metric: str, label: str, path: Path) -> None:
    """One metric against calls of a clip of N segments, a panel a variant; dashed are parallelograms."""
    import matplotlib
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogLocator, NullFormatter, ScalarFormatter

    def sampler(curve: dict[str, Any]) -> tuple[str, int, str]:
        variant = VARIANTS[curve["variant"]]
        taught = "student taught to overlap, " if "overlapping=true" in variant.settings else "student, "
        student = taught + "overlapping, " * (curve["lag"] < curve["K"]) if variant.teacher else ""
        return student, curve["K"], curve["variance"]

    samplers = sorted({sampler(curve) for curve in found["curves"]})
    panels = {name: [c for c in found["curves"] if (VARIANTS[c["variant"]].teacher or c["variant"]) == name]
              for name in VARIANTS}  # fmt: skip
    panels = {name: shown for name, shown in panels.items() if shown}
    names = [f"{student}K = {k}{', ' * bool(v)}{v}" for student, k, v in samplers]
    colours = {kind: COLOURS[k % len(COLOURS)] for k, kind in enumerate(samplers)}
    with matplotlib.rc_context(STYLE):
        columns = min(4, len(panels))
        rows = -(-len(panels) // columns)
        figure = Figure(figsize=(3 * columns, 1 + 2.5 * rows), layout="constrained")
        axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).flatten()
        for axis in axes[len(panels) :]:
            axis.set_visible(False)
        for axis, (title, shown) in zip(axes, panels.items(), strict=False):
            for kind in samplers:
                for shape, line in (("triangle", "-"), ("parallelogram", "--")):
                    line_of = [c for c in shown if (sampler(c), c["shape"]) == (kind, shape)]
                    values = [Interval.from_json(c["metrics"][metric]) for c in line_of]
                    # Student's t of two seeds is 12.7: it would hide all else.
                    halves = [
                        value.half_width if len(c["seeds"]) > 2 else 0.0
                        for c, value in zip(line_of, values, strict=True)
                    ]
                    axis.errorbar(
                        [c["calls"] for c in line_of], [value.mean for value in values], halves, ls=line, marker="o",
                        ms=3, lw=1.2, capsize=2, color=colours[kind],
                    )  # fmt: skip
            axis.set(xscale="log", title=title)
            axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.xaxis.set_major_formatter(ScalarFormatter())
            axis.xaxis.set_minor_formatter(NullFormatter())
            axis.grid()
        axes[0].set_ylim(bottom=0)
        for axis in axes[len(panels) - columns : len(panels)]:
            axis.set_xlabel("network calls")
            axis.tick_params(labelbottom=True)
        figure.supylabel(label)
        handles = [axes[0].plot([], [], "o-", color=colours[kind])[0] for kind in samplers]
        figure.legend(handles, names, loc="outside lower center", ncols=2 * columns)
        with atomic_write(path) as file:
            figure.savefig(file, format=path.suffix[1:], transparent=True)


def check_state(given: argparse.Namespace) -> None:
    """All of OUT is of one state of code, data and settings.

    Raises:
        InputError: OUT is of another.
    """
    asked = ("recipe", "train_steps", "student_steps", "repeats", "set")
    state = {name: getattr(given, name) for name in asked}
    state = json.loads(json.dumps(state | asdict(state_now(common(given)))))
    path = given.out / "state.json"
    there = json_object(path.read_bytes(), path, "give another --out") if path.is_file() else state
    if other := [name for name in state if there.get(name) != state[name]]:
        name = other[0]
        raise InputError(f"{given.out} was made with {name} {there.get(name)}, not {state[name]}; give another --out")
    write_report(path, state)


def main() -> None:
    """See the module."""
    parser = Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--corpus", type=Path, default=Path("data/corpus.safetensors"))
    parser.add_argument("--out", type=Path, default=Path("runs/rdm-grid"))
    parser.add_argument("--recipe", choices=RECIPES, default="small")
    parser.add_argument("--variants", nargs="+", choices=VARIANTS, default=list(VARIANTS), metavar="NAME")
    parser.add_argument("--seeds", type=at_least(1), default=3, help="trainings of each variant")
    parser.add_argument("--first-seed", type=at_least(0), default=0, help="of these; others may be made elsewhere")
    parser.add_argument("--train-steps", type=at_least(1), help="of all but students; by default the recipe's")
    parser.add_argument("--student-steps", type=at_least(1), help="of students; by default the recipe's")
    parser.add_argument("--set", action="append", default=[], help="a setting of all variants but students")
    parser.add_argument("--steps", type=at_least(1), nargs="+", default=list(STEPS), help="K; 1000 is DDPM")
    parser.add_argument("--late", type=at_least(0), nargs="+", default=list(LATE), help="R of K = 1000, 0 the flow")
    parser.add_argument("--items", type=at_least(1), help="at most so many of val; by default all")
    parser.add_argument("--repeats", type=at_least(1), default=1, help="of each point and seed, in processes")
    parser.add_argument("--evaluator", default=DEFAULT_EVALUATOR)
    parser.add_argument("--device", default="auto")
    parser.add_argument("--plot", action="store_true", help="make nothing; only gather and draw what is there")
    given = parser.parse_args()
    if not given.plot:
        given.out.mkdir(parents=True, exist_ok=True)
        check_state(given)
        # A whole grid of one seed is worth more than half of one of three.
        for seed in range(given.first_seed, given.first_seed + given.seeds):
            for name in given.variants:
                trained(name, seed, given)
                for point in points(VARIANTS[name], given.steps, given.late):
                    measure(name, seed, point, given)
    found = gather(given.out)
    write_report(given.out / "curves.json", found)
    for metric, label in (("fid", "FID"), ("r3", "R@3")):
        draw(found, metric, label, given.out / f"curves-{metric}.svg")
    for row in found["curves"]:
        values = [f"{metric} {Interval.from_json(row['metrics'][metric]).format()}" for metric in ("fid", "r3")]
        for base, words in (("minus_whole", "R = K"), ("minus_base", row["base"])):
            if less := row[base]:
                values.append(f"fid less that of {words} {Interval.from_json(less['fid']).format()}")
        overlapping = bool(VARIANTS[row["variant"]].teacher) and row["lag"] < row["K"]
        sampler = Point(row["K"], row["R"], row["shape"], row["variance"], overlapping).name
        print(f"{row['variant']:24} {sampler:32} {row['calls']:5} calls  {'  '.join(values)}  ({len(row['seeds'])})")


if __name__ == "__main__":
    sys.exit(exit_code_of(main))
