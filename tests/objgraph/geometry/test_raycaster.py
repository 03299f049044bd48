"""What is seen from somewhere outside, and what is not."""

import numpy as np
import pytest
import trimesh
from trimesh.sample import sample_surface

from objgraph.geometry.raycaster import seen_from_outside


@pytest.mark.parametrize("away", [0.0, 1e4])
def test_what_no_direction_sees_is_not_seen(away: float):
    outer, inner = trimesh.creation.box(np.ones(3)), trimesh.creation.box(0.4 * np.ones(3))
    points = np.concatenate([sample_surface(mesh, 200, seed=0)[0] for mesh in (outer, inner)])
    moved = [mesh.copy().apply_translation([away, 0, 0]) for mesh in (outer, inner)]
    shift = np.array([away, 0, 0])
    seen = seen_from_outside(moved, points + shift)
    assert seen[:200].all()
    assert not seen[200:].any()
    # through an open top something of the inner one is seen, and not its underside
    cup = trimesh.Trimesh(outer.vertices + shift, outer.faces[outer.face_normals[:, 1] < 0.9], process=False)
    seen = seen_from_outside([cup, moved[1]], points[200:] + shift)
    top, bottom = points[200:, 1] > 0.1999, points[200:, 1] < -0.1999
    assert seen[top].all()
    assert not seen[bottom].any()
