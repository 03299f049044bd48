"""What views that the graph's covariance chooses are worth, beside random and even ones.

    python -m objgraph.bench.active --out out/active --objects 50 --jobs 2

Each object stands in a room of its own and is seen once. Then the next view is chosen among 100 cameras that can be held
about it: by the information that the graph expects of each, at random, or evenly about the object. After each view the
object is estimated anew. `metrics.json`: how many views chance and even spreading need for the mean error of surfaces
(`views_*`) and of the boxes' corners (`views_*_box`; `*_right`: over objects that no policy ever has in a wrong heading)
that the expected information reaches with four, where `reached` says whether they do at all, and how well expected and
realised information go together, over all views and over those after which the object stands as before (within 45
degrees). Finished objects are not run again.
"""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import gtsam
import matplotlib.pyplot as plt
import numpy as np
import tyro
from rich.progress import track

from factors.state import ObjectState
from objgraph.active.cameras import reachable, sphere
from objgraph.active.next_view import Criterion, NextViewConfig, ViewGain, next_views
from objgraph.active.target import Target, target
from objgraph.atomic import write_file
from objgraph.bench.comparison.objects.calibration import RIGHT_MODE_DEG
from objgraph.bench.metrics.box_error import box_error, corners_m
from objgraph.bench.metrics.metrics import evaluate_object
from objgraph.bench.views_needed import Row, mean_errors, objects_of, seen_by_all, views_needed, within
from objgraph.bench.worlds.cases import UP, BenchmarkConfig, Case, World, synthetic_cases
from objgraph.covariance.box import box_pose
from objgraph.errors import ObjectGraphError, ObservationError
from objgraph.estimate.graph import GraphEstimator
from objgraph.estimate.task import Estimate, EstimationTask
from objgraph.graph.builder import ObjectBuilder
from objgraph.graph.initialise import InitialisationConfig, first_states
from objgraph.maps.pipeline import scene_floor
from objgraph.observation.frames import ListedFrames, Scan
from objgraph.observation.sampling import ObjectView, SamplingConfig, observe
from objgraph.priors.mesh import extract_mesh
from objgraph.priors.registry import load_prior
from objgraph.priors.shape_prior import ShapePrior
from objgraph.show.next_view import sphere_picture
from objgraph.synthetic.camera import intrinsics
from objgraph.work import Workers, spread

GOAL = 4
"""Views of the policy that the others are measured against."""
SAMPLING = SamplingConfig(points=150, hits=75, free=75)
FRESH = InitialisationConfig(guesses=5, points=100, rays=100, shortlist=2)
"""How a fresh guess is found once there is an estimate to go on from."""
TARGET = 1
POLICIES = ("next_best", "random", "even")


@dataclass
class Arguments:
    out: Path
    """Where metrics.json, the rows and the pictures go."""
    objects: int = 4
    """Half of them chairs, half tables; one is a chair."""
    jobs: int = 1
    """Objects at the same time."""
    seed: int = 0
    """Of objects, rooms and noise."""
    candidates: int = 100
    """Cameras to choose among."""
    distance: float = 1.9
    """From the camera to the object's middle, metres."""
    most: int = 6
    """Views that chance and even spreading get: half as many again as the policy."""
    criterion: Criterion = "corners"
    """What the next view is chosen for."""


@dataclass
class Subject:
    """One object to be looked at."""

    case: Case
    world: World
    prior: ShapePrior
    floor: float | None
    cameras: list[gtsam.Pose3]
    """Those to choose among."""
    first: ObjectView

    def look(self, camera: gtsam.Pose3, number: int) -> ObjectView | None:
        """Take a picture and what it shows of the object; None where that is next to nothing."""
        rng = np.random.default_rng([self.case.seed, self.case.index, number])
        try:
            return observe(self.world.frame(camera, str(number), rng), TARGET, SAMPLING, seed=number)
        except ObservationError:
            return None

    def estimate(self, views: Sequence[ObjectView], start: ObjectState | None) -> Estimate:
        """From all views, beginning where the last estimate ended and at the best fresh guess."""
        settings = InitialisationConfig() if start is None else FRESH
        builder = ObjectBuilder(up_world=UP, floor=self.floor)
        fresh = first_states(self.prior, views, builder, settings).states
        starts = (*fresh[:1], *([start] if start is not None else []))
        task = EstimationTask(self.case.id, self.prior, starts, tuple(views), UP, self.floor)
        (result,) = GraphEstimator().estimate([task])
        if isinstance(result, ObjectGraphError):
            raise result
        return result

    def known(self, estimate: Estimate, views: Sequence[ObjectView]) -> Target:
        assert estimate.covariance is not None
        seen_from = [view.T_world_camera for view in views]
        return target(
            self.case.id, self.prior, estimate.state, estimate.covariance,
            seen_from=seen_from, turns=estimate.turns,
        )  # fmt: skip

    def measure(self, estimate: Estimate) -> dict[str, Any]:
        """Against the truth, of which nothing else here knows."""
        assert estimate.covariance is not None
        state, truth = estimate.state, self.world.truth
        mesh = extract_mesh(self.prior.decoder, state.code)
        vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
        of_mesh = evaluate_object(state.T_world_object.matrix(), state.scale, vertices, faces, truth)
        box = box_pose(self.prior, state, estimate.covariance, vertices)
        return {**asdict(of_mesh), "box_m": corners_m(box, box_error(box, truth))}


def subject(case: Case, arguments: Arguments) -> Subject:
    """The object and its first view; cameras about where that view sees it."""
    world, prior = case.world(), load_prior(case.category)
    rng = np.random.default_rng([case.seed, case.index, 0])
    frame = world.frame(world.first_camera(), "0", rng)
    view = observe(frame, TARGET, SAMPLING)
    floor = scene_floor(
        Scan(case.id, ListedFrames([frame]), (case.instance,), UP)
    )  # by what has been seen, as all else
    middle = np.median(view.points_world, axis=0)
    cameras = sphere(middle, arguments.distance, UP, 3 * arguments.candidates, (5.0, 60.0))
    held = reachable(cameras, world.can_hold)
    chosen = np.random.default_rng(case.seed).permutation(len(held))[: arguments.candidates]
    return Subject(case, world, prior, floor, [held[i] for i in chosen], view)


def ranked(known: Target, cameras: list[gtsam.Pose3], criterion: Criterion) -> list[ViewGain]:
    return next_views([known], cameras, NextViewConfig(intrinsics()), criterion=criterion)


def realised(before: Estimate, after: Estimate) -> float:
    """Nats by which a view has narrowed pose, scale and code."""
    assert before.covariance is not None
    assert after.covariance is not None
    spreads = [np.linalg.slogdet(each.covariance.matrix)[1] for each in (before, after) if each.covariance]
    return 0.5 * (spreads[0] - spreads[1])


def turned(before: ObjectState, after: ObjectState) -> float:
    """Angle between two poses of an object, degrees."""
    between = before.T_world_object.rotation().between(after.T_world_object.rotation())
    return float(np.degrees(np.linalg.norm(gtsam.Rot3.Logmap(between))))


def row(item: Subject, policy: str, views: int, estimate: Estimate, **more: float) -> dict[str, Any]:
    return {"object": item.case.id, "policy": policy, "views": views, **item.measure(estimate), **more}


def one_by_one(item: Subject, policy: str, begun: Estimate, arguments: Arguments) -> list[dict[str, Any]]:
    """A view at a time: the next best, or any."""
    rng = np.random.default_rng([item.case.seed, item.case.index, 1])
    views, estimate, left, rows = [item.first], begun, list(item.cameras), []
    most = GOAL if policy == "next_best" else arguments.most
    while len(views) < most:
        order = ranked(item.known(estimate, views), left, arguments.criterion)
        if policy == "random":
            order = [order[i] for i in rng.permutation(len(order))]
        for best in order:  # a camera that sees next to nothing is passed over
            left = [camera for camera in left if camera is not best.T_world_camera]
            view = item.look(best.T_world_camera, len(views))
            if view is not None:
                break
        else:
            break
        views.append(view)
        before, estimate = estimate, item.estimate(views, estimate.state)
        gains = {
            "expected": best.objects[item.case.id].information,
            "realised": realised(before, estimate),
            "turned_deg": turned(before.state, estimate.state),
        }
        rows.append(row(item, policy, len(views), estimate, **gains))
    return rows


def evenly(item: Subject, begun: Estimate, arguments: Arguments) -> list[dict[str, Any]]:
    """All views of a ring at once, for every number of them: the nearest camera to each even bearing."""
    rows, middle = [], np.median(item.first.points_world, axis=0)
    away = item.first.T_world_camera.translation() - middle
    for count in range(2, arguments.most + 1):
        views, left = [item.first], list(item.cameras)
        for k in range(1, count):
            turned = gtsam.Rot3.Rz(2 * np.pi * k / count).matrix() @ (away * [1, 1, 0])
            level = arguments.distance * np.cos(np.radians(30)) * turned / np.linalg.norm(turned)
            wanted = middle + level + [0, 0, arguments.distance / 2]
            order = np.argsort([np.linalg.norm(camera.translation() - wanted) for camera in left])
            for i in order:
                view = item.look(left[i], k)
                if view is not None:
                    views.append(view)
                    left.pop(i)
                    break
        rows.append(row(item, "even", count, item.estimate(views, begun.state)))
    return rows


def run(case: Case, arguments: Arguments, picture: Path | None) -> list[dict[str, Any]]:
    """All policies on one object, from the same first view and the same first estimate."""
    item = subject(case, arguments)
    begun = item.estimate([item.first], None)
    rows = [row(item, policy, 1, begun) for policy in POLICIES]
    if picture is not None:
        known = item.known(begun, [item.first])
        views = ranked(known, item.cameras, arguments.criterion)
        sphere_picture(known, known.surface_sigma, views, UP, picture, criterion=arguments.criterion)
    for policy in ("next_best", "random"):
        rows += one_by_one(item, policy, begun, arguments)
    return rows + evenly(item, begun, arguments)


def attempt(
    case: Case, arguments: Arguments, picture: Path | None
) -> list[dict[str, Any]] | ObjectGraphError:
    """`run`, whose failure is its result."""
    try:
        return run(case, arguments, picture)
    except ObjectGraphError as error:
        return error


def compared(rows: Sequence[Row], measure: str, ending: str) -> dict[str, Any]:
    """Views that the other policies need for the policy's mean error, by one measure."""
    needed = views_needed(rows, POLICIES[0], GOAL, POLICIES[1:], measure)
    return {
        **{f"views_{policy}{ending}": count for policy, (count, _) in needed.items()},
        f"reached{ending}": {policy: reached for policy, (_, reached) in needed.items()},
    }


def curves(rows: Sequence[Row]) -> dict[str, dict[str, dict[int, float]]]:
    names = ("chamfer_m", "box_m", "translation_m", "rotation_deg", "scale_pct_max")
    return {name: {policy: mean_errors(rows, policy, name) for policy in POLICIES} for name in names}


def correlation(taken: Sequence[Row]) -> float | None:
    """Of expected and realised information."""
    if len(taken) < 2:
        return None
    return float(np.corrcoef([[r["expected"], r["realised"]] for r in taken], rowvar=False)[0, 1])


def summary(tried: Sequence[Row], arguments: Arguments) -> dict[str, Any]:
    most = {policy: GOAL if policy == POLICIES[0] else arguments.most for policy in POLICIES}
    rows = seen_by_all(tried, most)
    if not rows:
        raise SystemExit("no object was seen as often as every policy was to see it: give more --candidates")
    right = within(rows, "rotation_deg", RIGHT_MODE_DEG)
    taken = [r for r in rows if "expected" in r]
    return {
        "objects": len(objects_of(rows)),
        "objects_left_out": len(objects_of(tried)) - len(objects_of(rows)),
        "objects_right": len(objects_of(right)),
        "views_next_best": GOAL,
        **compared(rows, "chamfer_m", ""),
        **compared(rows, "box_m", "_box"),
        **compared(right, "box_m", "_box_right"),
        "gain_correlation": correlation(taken),
        "gain_correlation_same_mode": correlation([r for r in taken if r["turned_deg"] <= RIGHT_MODE_DEG]),
        "curves": curves(rows),
        "curves_right": curves(right),
        "settings": settings(arguments),
    }


def settings(arguments: Arguments) -> dict[str, str]:
    """What the rows depend on."""
    return {k: str(v) for k, v in vars(arguments).items() if k not in ("out", "objects", "jobs")}


def draw(metrics: dict[str, Any], path: Path) -> None:
    figure, axes = plt.subplots(1, 3, figsize=(12, 3.6), layout="constrained")
    count, right = metrics["objects"], metrics["objects_right"]
    panels = (
        ("curves", "chamfer_m", "Chamfer", f"{count} object{'s' * (count > 1)}"),
        ("curves", "box_m", "error of box corners", f"{count} object{'s' * (count > 1)}"),
        ("curves_right", "box_m", "error of box corners", f"the {right} never in a wrong heading"),
    )
    for axis, (over, name, label, which) in zip(axes, panels, strict=True):
        for policy in POLICIES:
            found = metrics[over][name][policy]
            errors = [100 * error for error in found.values()]
            axis.plot([int(n) for n in found], errors, "o-", label=policy.replace("_", " "))
        axis.set(xlabel="views", ylabel=f"mean {label} (cm)", title=which)
        axis.xaxis.get_major_locator().set_params(integer=True)
        axis.set_ylim(bottom=0)
        axis.grid(alpha=0.3)
    axes[0].legend()
    figure.savefig(path)


def main(arguments: Arguments) -> None:
    arguments.out.mkdir(parents=True, exist_ok=True)
    store = arguments.out / "rows.json"
    kept = json.loads(store.read_text()) if store.exists() else {"settings": settings(arguments), "rows": []}
    if kept["settings"] != settings(arguments):
        raise SystemExit(f"{store} is of other settings: choose another --out")
    each = -(-arguments.objects // 2)
    cases = [
        case
        for pair in zip(
            *(
                synthetic_cases(BenchmarkConfig(seed=arguments.seed, objects=each, categories=(name,)))
                for name in ("chair", "table")
            ),
            strict=True,
        )
        for case in pair
    ][: arguments.objects]
    done = {r["object"] for r in kept["rows"]}
    missing = [case for case in cases if case.id not in done]
    pictures = {cases[0].id: arguments.out / "information.png"}
    works = [partial(attempt, case, arguments, pictures.get(case.id)) for case in missing]
    for place, rows in track(spread(works, Workers(arguments.jobs)), "objects", total=len(works)):
        if isinstance(rows, ObjectGraphError):
            print(f"{missing[place].id} is left out: {rows}")
            continue
        kept["rows"] += rows
        write_file(store, (json.dumps(kept) + "\n").encode())
    chosen = [r for r in kept["rows"] if r["object"] in {case.id for case in cases}]
    metrics = summary(chosen, arguments)
    write_file(arguments.out / "metrics.json", (json.dumps(metrics, indent=2) + "\n").encode())
    draw(metrics, arguments.out / "active_vision.png")
    print({k: v for k, v in metrics.items() if k not in ("curves", "curves_right", "settings")})


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
