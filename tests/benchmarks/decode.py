"""What a point costs to decode, by torch's own layers and by oneDNN's: python -m tests.benchmarks.decode"""

import time
from collections.abc import Callable

import numpy as np
import torch

from factors import affine
from objgraph.priors.registry import load_prior

REPEATS = 15


def median_seconds(call: Callable[[], object]) -> float:
    call()
    spent = []
    for _ in range(REPEATS):
        begun = time.process_time()
        call()
        spent.append(time.process_time() - begun)
    return float(np.median(spent))


def main() -> None:
    torch.set_num_threads(1)
    prior = load_prior("chair")
    code = torch.as_tensor(prior.starts[:1]).to(prior.decoder.like)
    print(f"{'points':>7} {'':8} {'value':>12} {'with derivatives':>18}   microseconds a point")
    for count in (200, 2000, 20000):
        points = torch.rand(count, 3, generator=torch.Generator().manual_seed(0)) - 0.5
        for name, onednn in (("torch", False), ("oneDNN", True)):
            affine._has_onednn = lambda onednn=onednn: onednn  # pyright: ignore[reportAttributeAccessIssue]
            with torch.no_grad():
                value = median_seconds(lambda p=points: prior.decoder(p, code))
            jet = median_seconds(lambda p=points: prior.decoder.linearize(p, code))
            print(f"{count:7d} {name:8} {1e6 * value / count:12.2f} {1e6 * jet / count:18.2f}")


if __name__ == "__main__":
    main()
