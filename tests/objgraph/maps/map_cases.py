"""Objects of a map, made up."""

from typing import Any

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from objgraph.maps.mapped_object import MappedObject, PriorReference
from objgraph.maps.other_estimate import OtherEstimate
from objgraph.trust.verdict import Trust

UP = np.array([0.0, 0.0, 1.0])


def other(seed: int = 0, **changes: Any) -> OtherEstimate:
    rng = np.random.default_rng(seed)
    T = np.eye(4)
    T[:3, :3] = Rotation.random(rng=rng).as_matrix()
    given = {
        "estimator": "adam",
        "T_world_object": T,
        "scale": rng.uniform(0.5, 2, 3),
        "code": rng.normal(size=8),
        "covariance": np.diag(rng.uniform(0, 1, 9)),
        "code_sigma": rng.uniform(0, 1, 8),
    }
    return OtherEstimate(**(given | changes))


def mapped(identifier: int = 1, seed: int = 0, **changes) -> MappedObject:
    rng = np.random.default_rng(seed)
    T = np.eye(4)
    T[:3, :3] = Rotation.random(rng=rng).as_matrix()
    T[:3, 3] = rng.normal(size=3)
    root = rng.normal(size=(9 + 8, 9 + 8))
    joint = root @ root.T
    ball = trimesh.creation.icosphere(1, radius=0.4)
    given = {
        "category": "chair",
        "status": "mapped",
        "T_world_object": T,
        "scale": rng.uniform(0.5, 2, 3),
        "code": rng.normal(size=8),
        "covariance": joint[:9, :9],
        "code_sigma": np.sqrt(np.diag(joint)[9:]),
        "estimator": "graph",
        "cost_initial": 120.5,
        "cost_final": 3.25,
        "linearizations": 12,
        "error_evaluations": 17,
        "seconds": 4.5,
        "seconds_by_stage": {"initialise": 1.5, "solve": 3.0},
        "views": ("0", "12"),
        "cameras": np.tile(T, (len(changes.get("views", ("0", "12"))), 1, 1)),
        "size_m": rng.uniform(0.5, 2, 3),
        "box_centre": rng.normal(size=3),
        "box_extents": rng.uniform(0.5, 2, 3),
        "box_covariance": 1.5 * joint[:9, :9],
        "trust": Trust(0.75, 0.5, ("two headings fit",), {"box": {"95": 1.0}}, {"seen": 0.5}, "0123"),
        "turns": rng.dirichlet(np.ones(4)),
        "turned": rng.normal(size=(4, 9 + (8 if changes.get("code") is None else len(changes["code"])))),
        "prior": PriorReference("chair", "ab12"),
        "vertices": np.asarray(ball.vertices) + T[:3, 3],
        "faces": np.asarray(ball.faces),
        "vertex_sigma": rng.uniform(0.001, 0.05, len(ball.vertices)),
        "joint_covariance": joint,
    }
    if changes.keys() & {"code", "covariance", "code_sigma"}:
        del given["joint_covariance"]
    return MappedObject(identifier, **(given | changes))


def failed(identifier: int = 9, reason: str = "seen in 12 pixels") -> MappedObject:
    return MappedObject(identifier, "table", "failed", reason)


def assert_same(a: MappedObject, b: MappedObject) -> None:
    for name in vars(a):
        one, other = getattr(a, name), getattr(b, name)
        if isinstance(one, np.ndarray):
            single = name in ("vertices", "vertex_sigma")
            np.testing.assert_array_equal(one.astype(np.float32) if single else one, other)
        else:
            assert one == other, name
