"""The distance to what is solid and in which direction it grows, at single points (host, compiled)."""

import math
from typing import no_type_check

from jaxplan.search.kernels.cells import index
from jaxplan.search.kernels.compiled import inner
from jaxplan.search.kernels.solids import BOX, CAPSULE, PLANE, REACH, SPHERE, in_cell, to_grid, to_primitive


@inner
@no_type_check
def clearance_slope(solids, x, y, z):
    """``solids.clearance_at`` and its derivative: that of what is nearest alone, 0 beyond ``REACH``."""
    kinds, numbers, _, first, members, bins, mesh, mesh_frame, voxels, voxels_frame = solids
    nx, ny, nz, ox, oy, oz, h = bins
    b = (index(x, ox, h, nx) * ny + index(y, oy, h, ny)) * nz + index(z, oz, h, nz)
    least, nearest = REACH, -1
    for at in range(first[b], first[b + 1]):
        n = members[at]
        apart = to_primitive(kinds[n], numbers[n], x, y, z)
        if apart < least:
            least, nearest = apart, n
    slope = _of_primitive(kinds[nearest], numbers[nearest], x, y, z) if nearest >= 0 else (0.0, 0.0, 0.0)
    if mesh.size > 0:
        apart = to_grid(mesh, mesh_frame, x, y, z)
        if apart < least:
            least, slope = apart, _of_grid(mesh, mesh_frame, x, y, z)
    if voxels.size > 0:
        apart = to_grid(voxels, voxels_frame, x, y, z)
        if apart < least:
            least, slope = apart, _of_grid(voxels, voxels_frame, x, y, z)
    return least, slope


@inner
@no_type_check
def _of_primitive(kind, row, x, y, z):
    """Direction in which the distance to one primitive grows."""
    if kind == PLANE:
        return row[0], row[1], row[2]
    dx, dy, dz = x - row[0], y - row[1], z - row[2]
    if kind == SPHERE:
        return _unit(dx, dy, dz)
    if kind == BOX:
        return _of_box(row, dx, dy, dz)
    along = row[3] * dx + row[4] * dy + row[5] * dz
    rx, ry, rz = dx - along * row[3], dy - along * row[4], dz - along * row[5]
    across, end = math.sqrt(rx * rx + ry * ry + rz * rz), 1.0 if along > 0.0 else -1.0
    radial, axial = across - row[6], abs(along) - row[7]
    if kind == CAPSULE:
        radial, axial = across, max(axial, 0.0)
    elif max(radial, axial) <= 0.0:
        radial, axial = (1.0, 0.0) if radial >= axial else (0.0, 1.0)
    else:
        radial, axial = max(radial, 0.0), max(axial, 0.0)
    size = math.sqrt(radial * radial + axial * axial)
    out, up = (radial / (size * across) if size * across > 0.0 else 0.0), (end * axial / size if size > 0.0 else 0.0)
    return out * rx + up * row[3], out * ry + up * row[4], out * rz + up * row[5]


@inner
@no_type_check
def _of_box(row, dx, dy, dz):
    """The same for a box, from where the point is beside its middle."""
    u = row[6] * dx + row[9] * dy + row[12] * dz
    v = row[7] * dx + row[10] * dy + row[13] * dz
    w = row[8] * dx + row[11] * dy + row[14] * dz
    a, b, c = abs(u) - row[3], abs(v) - row[4], abs(w) - row[5]
    most = max(a, max(b, c))
    if most > 0.0:
        a, b, c = max(a, 0.0), max(b, 0.0), max(c, 0.0)
    else:
        a, b, c = (1.0, 0.0, 0.0) if a == most else (0.0, 1.0, 0.0) if b == most else (0.0, 0.0, 1.0)
    a, b, c = _unit(math.copysign(a, u), math.copysign(b, v), math.copysign(c, w))
    return (
        row[6] * a + row[7] * b + row[8] * c,
        row[9] * a + row[10] * b + row[11] * c,
        row[12] * a + row[13] * b + row[14] * c,
    )


@inner
@no_type_check
def _unit(x, y, z):
    """A vector's direction; 0 of none."""
    size = math.sqrt(x * x + y * y + z * z)
    return (x / size, y / size, z / size) if size > 0.0 else (0.0, 0.0, 0.0)


@inner
@no_type_check
def _of_grid(squared, frame, x, y, z):
    """The same for the bound by squared distances at nodes."""
    nx, ny, nz, ox, oy, oz, h = frame
    i, u, du = in_cell((x - ox) / h, nx)
    j, v, dv = in_cell((y - oy) / h, ny)
    m, w, dw = in_cell((z - oz) / h, nz)
    bound, gu, gv, gw = 0.0, 0.0, 0.0, 0.0
    for a in range(2):
        p, dp = (u, 1.0) if a else (1.0 - u, -1.0)
        for b in range(2):
            q, dq = (v, 1.0) if b else (1.0 - v, -1.0)
            for c in range(2):
                r, dr = (w, 1.0) if c else (1.0 - w, -1.0)
                node = squared[i + a, j + b, m + c]
                bound, gu = bound + p * q * r * node, gu + dp * q * r * node
                gv, gw = gv + p * dq * r * node, gw + p * q * dr * node
    bound -= h * h * (u * (1.0 - u) + v * (1.0 - v) + w * (1.0 - w))
    root, away = math.sqrt(max(bound, 0.0)), math.sqrt(du * du + dv * dv + dw * dw)
    out = _unit(du, dv, dw)
    if root - h * away <= h * away:
        return out
    scale = 0.5 / (h * root)
    gu = scale * (gu - h * h * (1.0 - 2.0 * u)) if du == 0.0 else -out[0]
    gv = scale * (gv - h * h * (1.0 - 2.0 * v)) if dv == 0.0 else -out[1]
    gw = scale * (gw - h * h * (1.0 - 2.0 * w)) if dw == 0.0 else -out[2]
    return gu, gv, gw
