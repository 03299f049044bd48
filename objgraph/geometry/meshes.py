"""What trimesh says with warnings."""

import numpy as np
import trimesh


def signed_volume(mesh: trimesh.Trimesh) -> float:
    """Volume of a closed mesh, negative where its faces look inwards; zero of one that is flat.

    (`Trimesh.volume` finds the inertia with it, and divides by the volume.)
    """
    a, b, c = np.moveaxis(np.asarray(mesh.triangles), 1, 0)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)
