"""What a linearisation takes, over the products of the decoder's own layers on the same samples."""

from collections.abc import Callable
from pathlib import Path

import gtsam
import torch

from factors.affine import affine
from factors.batch import prefetch
from factors.decoder import Decoder
from objgraph.bench.speed.figure import Figure, in_turns, ratio
from objgraph.datasets.registry import load_scan
from objgraph.errors import EvaluationError
from objgraph.estimate.graph import GraphEstimator
from objgraph.graph.builder import ObjectBuilder
from objgraph.graph.initialise import first_states
from objgraph.graph.single_object import ALONE, SingleObject
from objgraph.graph.solve import SolverConfig, solve
from objgraph.maps.pipeline import MappingConfig, observe_instance, scene_floor
from objgraph.observation.sampling import thinned
from objgraph.observation.view_selection import summarize
from objgraph.priors.registry import prior_for
from objgraph.work import threads

_ROWS = 2048
"""Of a product, as a decoder makes them."""


def over_floor(root: Path, repeats: int) -> Figure:
    """Linearising a solved chair of the sample scan, whole, over its decoder's products alone.

    Raises EvaluationError where the chair's decoder is none whose products are known.
    """
    single, decoder = _solved_chair(root)
    queries = [(factor, factor.query(single.values)) for factor in single.factors]
    prefetch(single.factors, single.values, jacobian=True)
    values = sum(len(query.p_object) for _, query in queries)
    jets = 0
    for factor, query in queries:
        value = factor.known_value(query)
        assert value is not None
        jets += len(factor.active(query, value))
    code, count = single.state.code, 0

    def linearize() -> None:
        nonlocal count
        count += 1  # elsewhere by next to nothing: what was decoded before is known
        elsewhere = gtsam.Values(single.values)
        elsewhere.update(ALONE.code, code + 1e-9 * count)
        prefetch(single.factors, elsewhere, jacobian=True)
        single.graph.error(elsewhere)
        single.graph.linearize(elsewhere)

    with threads(1), torch.no_grad():
        spent = in_turns({"whole": linearize, "floor": _products(decoder, values, jets)}, repeats)
    what = (
        f"processor time; a chair of the sample from three views, {values} samples, {jets} of them with derivatives; "
        f"{repeats} repeats in turns; {1e3 * sorted(spent['whole'])[repeats // 2]:.0f} ms"
    )
    return ratio("linearisation_over_floor", spent["whole"], spent["floor"], 1.3, what)


def _solved_chair(root: Path) -> tuple[SingleObject, Decoder]:
    scan, config = load_scan("sample", root), MappingConfig()
    chair = next(each for each in scan.instances if each.category == "chair")
    prior = prior_for("chair")
    if not isinstance(prior.decoder, Decoder):
        raise EvaluationError("the chair prior's decoder is of another kind: its products are not known")
    views = observe_instance(scan.frames, chair, summarize(scan.frames, config.view), config)
    views = thinned(views, GraphEstimator.samples, GraphEstimator.samples)
    builder = ObjectBuilder(config.graph, scan.up_world, scene_floor(scan))
    first = first_states(prior, views, builder, config.initialisation)
    single = builder.alone(prior, first.states[0], views)
    solve([single], SolverConfig())
    single.refresh(SolverConfig().slopes[-1])
    return single, prior.decoder


def _products(decoder: Decoder, values: int, jets: int) -> Callable[[], None]:
    """Every layer's product forward for all samples, and forward and backward for those with derivatives."""
    inner = [layer.weight for layer in decoder.hidden if isinstance(layer, torch.nn.Linear)]
    points = [layer.weight for layer in decoder.from_point.values() if isinstance(layer, torch.nn.Linear)]
    width, length = decoder.config.width, decoder.code_length
    forward = [*points, *inner, decoder.output.weight]
    to_code = [torch.randn(length, width) for _ in decoder.from_code]
    backward = [*(each.t().contiguous() for each in (*points, *inner)), *to_code]
    of_size = {n: torch.randn(_ROWS, n) for n in {each.shape[1] for each in (*forward, *backward)}}

    def run() -> None:
        for weights, rows in ((forward, values), (forward, jets), (backward, jets)):
            for start in range(0, rows, _ROWS):
                for weight in weights:
                    affine(of_size[weight.shape[1]][: min(_ROWS, rows - start)], weight)

    return run
