"""Work done by this process, by others of this machine, or by a Ray cluster, with the same result."""

from objgraph.work.processes import in_order, prepare, process_pool
from objgraph.work.spread import HERE, Engine, Workers, spread
from objgraph.work.worker import begin_worker, keep_memory, threads, torch_threads

__all__ = [
    "HERE",
    "Engine",
    "Workers",
    "begin_worker",
    "in_order",
    "keep_memory",
    "prepare",
    "process_pool",
    "spread",
    "threads",
    "torch_threads",
]
