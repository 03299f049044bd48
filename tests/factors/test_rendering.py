import numpy as np
import pytest
import torch
from scipy.integrate import trapezoid
from scipy.stats import norm

from factors.rays import RayCells
from factors.rendering import FullDistribution, Probabilistic, RayTargets
from factors.score import energy_score

RENDERERS = [
    FullDistribution(),
    FullDistribution(correlation="independent"),
    Probabilistic(),
    Probabilistic(variance="epistemic"),
]


def _scene(rays: int = 5, k: int = 8, seed: int = 0):
    generator = torch.Generator().manual_seed(seed)
    edges = torch.linspace(1, 2, k + 1).double().expand(rays, -1)
    cells = RayCells(0.5 * (edges[:, 1:] + edges[:, :-1]), edges.diff(dim=1), edges[:, -1])
    sdf = 0.2 * torch.randn(rays, k, generator=generator).double()
    sdf_sigma = 0.01 + 0.02 * torch.rand(rays, k, generator=generator).double()
    hit = torch.arange(rays) % 2 == 0
    depth = torch.where(hit, 1.5, torch.tensor([torch.inf, 1.3]).repeat(rays)[:rays].double())
    return sdf, sdf_sigma, cells, RayTargets(depth.double(), hit, torch.full((rays,), 0.01).double())


@pytest.mark.parametrize("renderer", RENDERERS)
def test_rows_have_the_gradient_of_the_loss(renderer):
    sdf, sdf_sigma, cells, targets = _scene()
    spread = renderer.freeze(sdf, sdf_sigma, cells, targets, 60.0)

    def loss(values):
        return renderer.render(values, sdf_sigma, cells, targets, 60.0, spread).loss.sum()

    rendered = renderer.render(sdf, sdf_sigma, cells, targets, 60.0, spread)
    gradient = torch.einsum("rqk,rq->rk", rendered.d_sdf, rendered.residual)
    step = 1e-6
    for i in np.ndindex(*sdf.shape):
        up, down = sdf.clone(), sdf.clone()
        up[i] += step
        down[i] -= step
        numeric = float(loss(up) - loss(down)) / (2 * step)
        assert float(gradient[i]) == pytest.approx(numeric, rel=1e-4, abs=1e-6)
    assert (0.5 * rendered.residual.square().sum(dim=1) <= rendered.loss + 1e-12).all()


@pytest.mark.parametrize("correlation", ["comonotone", "independent"])
def test_full_distribution_is_the_numerical_crps(correlation):
    renderer = FullDistribution(correlation)
    k = 4000
    sdf, _, _, targets = _scene(rays=5, k=6)
    # the same SDF, finely and linearly interpolated: the sum over cells becomes the integral
    fine = torch.nn.functional.interpolate(sdf[:, None], size=k, mode="linear", align_corners=True)[:, 0]
    if correlation == "independent":
        fine = fine + 0.5  # a product over 4,000 samples would otherwise end every ray at once
    edges = torch.linspace(1, 2, k + 1).double().expand(5, -1)
    cells = RayCells(0.5 * (edges[:, 1:] + edges[:, :-1]), edges.diff(dim=1), edges[:, -1])
    sigma = torch.full_like(fine, 0.05)
    spread = renderer.freeze(fine, sigma, cells, targets, 200.0)
    loss = renderer.render(fine, sigma, cells, targets, 200.0, spread).loss
    tau = np.sqrt(0.05**2 + 0.01**2 + (1.702 / 200) ** 2)
    clear = norm.cdf(fine.numpy() / tau)
    passed = np.minimum.accumulate(clear, 1) if correlation == "comonotone" else np.cumprod(clear, 1)
    depth = cells.depth.numpy()
    for ray in range(5):
        observed, hit = float(targets.depth[ray]), bool(targets.hit[ray])
        step = (depth[ray] >= observed).astype(float) if hit else np.zeros(k)
        error = (1 - passed[ray] - step) ** 2
        if not hit:
            error[depth[ray] >= observed] = 0.0
        expected = trapezoid(error, depth[ray]) + 0.1 * 2.0 * hit * passed[ray, -1] ** 2
        assert float(loss[ray]) == pytest.approx(expected, rel=2e-3, abs=1e-5)


def test_the_distribution_of_a_plane_is_gaussian_and_so_is_its_score():
    """A plane across the ray, thick behind: F is Phi((d - surface) / tau), whose score has a closed form."""
    k, tau = 4000, np.sqrt(0.03**2 + 0.01**2 + (1.702 / 400) ** 2)
    edges = torch.linspace(1, 2, k + 1).double()[None]
    cells = RayCells(0.5 * (edges[:, 1:] + edges[:, :-1]), edges.diff(dim=1), edges[:, -1])
    sdf, sigma = 1.45 - cells.depth, torch.full_like(cells.depth, 0.03)
    targets = RayTargets(torch.tensor([1.5]).double(), torch.tensor([True]), torch.tensor([0.01]).double())
    renderer = FullDistribution()
    spread = renderer.freeze(sdf, sigma, cells, targets, 400.0)
    assert float(spread) == pytest.approx(tau)
    loss = renderer.render(sdf, sigma, cells, targets, 400.0, spread).loss
    expected = energy_score(torch.tensor(-0.05).double(), torch.tensor(tau).double())
    assert float(loss) == pytest.approx(float(expected), rel=1e-3)


def test_comonotone_does_not_depend_on_the_sampling_and_independent_does():
    def behind(correlation, k):
        depth = torch.linspace(-0.1, 0.1, k, dtype=torch.float64)[None]
        tau = torch.full_like(depth, 0.02)
        # a sheet, 1 cm thick
        return float(FullDistribution(correlation).transmittance(depth.abs() - 0.005, tau)[0][0, -1])

    assert behind("comonotone", 41) == pytest.approx(behind("comonotone", 401), abs=1e-6)
    assert behind("independent", 401) < 0.5 * behind("independent", 41)


@pytest.mark.parametrize("renderer", RENDERERS)
def test_a_free_ray_that_passes_the_object_costs_nothing(renderer):
    sdf, sdf_sigma, cells, targets = _scene()
    targets = RayTargets(torch.full_like(targets.depth, torch.inf), torch.zeros(5, dtype=bool), targets.sigma)
    far = torch.full_like(sdf, 1.0)
    spread = renderer.freeze(far, sdf_sigma, cells, targets, 400.0)
    loss = renderer.render(far, sdf_sigma, cells, targets, 400.0, spread).loss
    assert float(loss.max()) < 0.24 * float(spread.max())
