"""A camera's lens: where a point before it is in a picture, as OpenCV has it (Brown 1966).

x is right, y down, z ahead, and for a point at (x, y) = (X, Y) / Z with r^2 = x^2 + y^2,

    x' = x (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2),    u = fx x' + cx,
    y' = y (1 + k1 r^2 + k2 r^4 + k3 r^6) + p1 (r^2 + 2 y^2) + 2 p2 x y,    v = fy y' + cy.
"""

import numpy as np

from armflex.conventions import Array


def projected(points: Array, focal: Array, centre: Array, lens: Array) -> tuple[Array, Array]:
    """Return (N, C, 2) pictures [px] of (N, C, 3) points in the camera's frame [m], and (N, C, 2, 3) their change.

    Args:
        points: With z other than 0; behind the camera it is as if seen through it.
        focal, centre: (N, 2) [px].
        lens: (N, 5) k1 k2 p1 p2 k3, dimensionless.
    """
    depth = points[..., 2:]
    flat = points[..., :2] / depth
    bent, bend = distorted(flat, lens[:, None])
    by_flat = focal[:, None, :, None] * bend
    change = np.empty((*flat.shape, 3))
    change[..., :2] = by_flat / depth[..., None]
    change[..., 2] = -(by_flat @ flat[..., None])[..., 0] / depth
    return focal[:, None] * bent + centre[:, None], change


def distorted(flat: Array, lens: Array) -> tuple[Array, Array]:
    """Return (..., 2) x', y' of (..., 2) x, y, and (..., 2, 2) their change; `lens` is (..., 5), dimensionless."""
    (x, y), (k1, k2, p1, p2, k3) = np.moveaxis(flat, -1, 0), np.moveaxis(lens, -1, 0)
    r2 = x * x + y * y
    radial, slope = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3)), 2.0 * (k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3))
    bent = np.stack([x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
                     y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y], axis=-1)  # fmt: skip
    across = slope * x * y + 2.0 * (p1 * x + p2 * y)
    rows = [[radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x, across],
            [across, radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x]]  # fmt: skip
    return bent, np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def by_lens(points: Array, pixels: Array, focal: Array, centre: Array) -> Array:
    """Return (N, C, 2, 9) the change of (N, C, 2) pictures [px] with focal lengths, centre and distortion."""
    x, y = np.moveaxis(points[..., :2] / points[..., 2:], -1, 0)
    r2 = x * x + y * y
    change = np.zeros((*pixels.shape, 9))
    bent = (pixels - centre[:, None]) / focal[:, None]
    for i, coordinate in enumerate((x, y)):
        change[..., i, i], change[..., i, 2 + i] = bent[..., i], 1.0
        tangent = (2.0 * x * y, r2 + 2.0 * coordinate * coordinate)[:: 1 if i == 0 else -1]
        by_distortion = np.stack([coordinate * r2, coordinate * r2**2, *tangent, coordinate * r2**3], axis=-1)
        change[..., i, 4:] = focal[:, None, i, None] * by_distortion
    return change
