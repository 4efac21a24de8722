"""Closest-hit ray casting against a scene's primitives, in the camera frame.

Vectors are tuples of three floats, which Numba keeps in registers. A ray is p + t·d with d of any length; a miss is
an index of -1. All shapes but one have closed forms; a rounded prism is convex, so its distance along a ray is a convex
function, and Newton's method reaches the first root from outside without passing it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from polarmap.geometry.pose import inverse
from polarmap.jit import njit
from polarmap.synth.bounding import bounding_tree
from polarmap.synth.scene import MOST_CORNERS, Material, PointLight, Primitive, Prism, Revolved, Scene, Shape

_NEAREST = 1e-4  # metres; hits nearer than this are the surface that the ray leaves
_ON_SURFACE = 1e-10  # metres, of Newton's method
_NEWTON_STEPS = 50
_NO_IMAGES = np.zeros((0, 2, 2), np.float32)

PRIMITIVE = np.dtype(
    [
        ("shape", np.int64),
        ("material", np.int64),
        ("R_object_camera", np.float64, (3, 3)),
        ("origin", np.float64, (3,)),  # the camera's centre in the object frame
        ("half_size", np.float64, (3,)),
        ("profile", np.float64, (3,)),  # of a revolved
        ("outline", np.float64, (MOST_CORNERS, 2)),  # of a prism
        ("corners", np.int64),
        ("rounding", np.float64),
    ]
)
MATERIAL = np.dtype(
    [
        ("albedo", np.float64),
        ("eta", np.float64),
        ("gloss", np.float64),
        ("shininess", np.float64),
        ("absorption", np.float64),  # 0 for a dielectric
        ("pattern", np.int64),  # 0 for a bare surface
        ("size", np.float64),
        ("contrast", np.float64),
        ("octaves", np.int64),
        ("seed", np.int64),
        ("image", np.int64),
    ]
)
LIGHT = np.dtype(
    [
        ("position", np.float64, (3,)),  # camera frame
        ("intensity", np.float64),
        ("shadows", np.int64),
    ]
)


class PackedScene(NamedTuple):
    """A scene as kernels take it, in the frame of one camera."""

    primitives: np.ndarray  # PRIMITIVE
    tree: np.ndarray  # NODE, over the primitives
    materials: np.ndarray  # MATERIAL
    lights: np.ndarray  # LIGHT
    surround: float
    images: np.ndarray  # float32 N×H×W


def pack(scene: Scene, T_world_camera: np.ndarray) -> PackedScene:
    """The scene for a camera at `T_world_camera` (4×4)."""
    materials = scene.materials
    T_camera_world = inverse(T_world_camera)
    return PackedScene(
        primitives=np.array([_primitive_row(p, materials, T_world_camera) for p in scene.primitives], PRIMITIVE),
        tree=_tree(scene, T_camera_world),
        materials=np.array([_material_row(m) for m in materials], MATERIAL),
        lights=np.array([_light_row(light, T_camera_world) for light in scene.lights], LIGHT),
        surround=float(scene.surround),
        images=_NO_IMAGES if scene.images is None else np.ascontiguousarray(scene.images, np.float32),
    )


def _tree(scene: Scene, T_camera_world: np.ndarray) -> np.ndarray:
    centres = np.array([p.T_world_object[:3, 3] for p in scene.primitives]).reshape(-1, 3)
    radii = np.array([p.bounding_radius for p in scene.primitives])
    return bounding_tree(centres @ T_camera_world[:3, :3].T + T_camera_world[:3, 3], radii)


def _primitive_row(primitive: Primitive, materials: tuple[Material, ...], T_world_camera: np.ndarray) -> tuple:
    T_object_camera = inverse(primitive.T_world_object) @ T_world_camera
    outline, corners, rounding = np.zeros((MOST_CORNERS, 2)), 0, 0.0
    if isinstance(primitive, Prism):
        corners, rounding = len(primitive.outline), primitive.rounding
        outline[:corners] = primitive.outline
    return (
        primitive.shape,
        materials.index(primitive.material),
        T_object_camera[:3, :3],
        T_object_camera[:3, 3],
        primitive.half_size,
        primitive.profile if isinstance(primitive, Revolved) else (0.0, 0.0, 0.0),
        outline,
        corners,
        rounding,
    )


def _light_row(light: PointLight, T_camera_world: np.ndarray) -> tuple:
    position = T_camera_world[:3, :3] @ light.position + T_camera_world[:3, 3]
    return position, light.intensity, light.shadows


def _material_row(material: Material) -> tuple:
    albedo = 0.0 if material.is_metal else material.albedo
    optics = (albedo, material.eta, material.gloss, material.shininess, material.absorption)
    texture = material.texture
    if texture is None:
        return (*optics, 0, 1.0, 0.0, 1, 0, 0)
    return (*optics, texture.pattern, texture.size, texture.contrast, texture.octaves, texture.seed, texture.image)


@njit
def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit
def cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit
def advance(p, t, d):
    """p + t·d."""
    return p[0] + t * d[0], p[1] + t * d[1], p[2] + t * d[2]


@njit(error_model="numpy")
def unit(a):
    s = 1.0 / math.sqrt(dot(a, a))
    return a[0] * s, a[1] * s, a[2] * s


@njit
def facing(n, d):
    """n or -n, whichever points against d."""
    return n if dot(n, d) < 0.0 else (-n[0], -n[1], -n[2])


@njit
def _row_dot(R, row, a):
    return R[row, 0] * a[0] + R[row, 1] * a[1] + R[row, 2] * a[2]


@njit
def _to_object_direction(primitive, a):
    R = primitive.R_object_camera
    return _row_dot(R, 0, a), _row_dot(R, 1, a), _row_dot(R, 2, a)


@njit
def _to_camera_direction(primitive, a):
    R = primitive.R_object_camera
    return (
        R[0, 0] * a[0] + R[1, 0] * a[1] + R[2, 0] * a[2],
        R[0, 1] * a[0] + R[1, 1] * a[1] + R[2, 1] * a[2],
        R[0, 2] * a[0] + R[1, 2] * a[1] + R[2, 2] * a[2],
    )


@njit
def to_object(primitive, point):
    """A point of the camera frame in the object frame of a primitive."""
    return advance(_to_object_direction(primitive, point), 1.0, primitive.origin)


@njit
def closest_hit(scene, p, d, farthest):
    """(index, t) of the first primitive that the ray meets before t = `farthest`; index -1 where none."""
    best, best_t = -1, farthest
    squared = dot(d, d)
    at = 0
    while at < scene.tree.size:
        node = scene.tree[at]
        if _passes_by(node, p, d, squared):
            at += node.leap
            continue
        if node.primitive >= 0:
            t = _hit(scene.primitives[node.primitive], p, d, best_t)
            if t < best_t:
                best, best_t = node.primitive, t
        at += 1
    return best, best_t


@njit
def is_blocked(scene, p, d, farthest):
    """Whether anything stands on the ray before t = `farthest`."""
    squared = dot(d, d)
    at = 0
    while at < scene.tree.size:
        node = scene.tree[at]
        if _passes_by(node, p, d, squared):
            at += node.leap
            continue
        if node.primitive >= 0 and _hit(scene.primitives[node.primitive], p, d, farthest) < farthest:
            return True
        at += 1
    return False


@njit
def _passes_by(node, p, d, squared):
    """Whether the ray misses a node's sphere; `squared` is |d|²."""
    c = node.centre
    to_centre = (c[0] - p[0], c[1] - p[1], c[2] - p[2])
    outside = dot(to_centre, to_centre) - node.bound
    along = dot(to_centre, d)
    return outside > 0.0 and (along < 0.0 or outside * squared > along * along)


@njit
def normal_at(primitive, point):
    """Unit normal, of either sign, of a primitive at a point on its surface, both in the camera frame."""
    return _to_camera_direction(primitive, _object_normal(primitive, to_object(primitive, point)))


@njit
def _object_normal(primitive, local):
    half = primitive.half_size
    if primitive.shape == Shape.SPHERE:
        return unit(local)
    if primitive.shape == Shape.BOX:
        return _box_normal(half, local)
    if primitive.shape == Shape.CYLINDER and abs(local[2]) / half[2] < math.hypot(local[0], local[1]) / half[0]:
        return unit((local[0], local[1], 0.0))
    if primitive.shape == Shape.REVOLVED:
        return _revolved_normal(primitive, local)
    if primitive.shape == Shape.PRISM:
        _, normal = _prism_distance(primitive, local)
        return normal
    return 0.0, 0.0, 1.0


@njit(error_model="numpy")
def _box_normal(half, local):
    x, y, z = abs(local[0]) / half[0], abs(local[1]) / half[1], abs(local[2]) / half[2]
    if x >= y and x >= z:
        return 1.0, 0.0, 0.0
    return (0.0, 1.0, 0.0) if y >= z else (0.0, 0.0, 1.0)


@njit
def _hit(primitive, p, d, farthest):
    """t of the ray's first meeting with one primitive, or infinity; may be cut short beyond `farthest`."""
    if primitive.shape == Shape.RECTANGLE:
        return _hit_rectangle(primitive, p, d, farthest)
    o, e = to_object(primitive, p), _to_object_direction(primitive, d)
    if primitive.shape == Shape.BOX:
        return _hit_box(primitive.half_size, o, e)
    if primitive.shape == Shape.SPHERE:
        return _hit_sphere(primitive.half_size[0], o, e)
    if primitive.shape == Shape.CYLINDER:
        return _hit_cylinder(primitive.half_size, o, e)
    if primitive.shape == Shape.REVOLVED:
        return _hit_revolved(primitive, o, e)
    return _hit_prism(primitive, o, e, farthest)


@njit(error_model="numpy")
def _hit_rectangle(rectangle, p, d, farthest):
    R, origin, half = rectangle.R_object_camera, rectangle.origin, rectangle.half_size
    t = -(_row_dot(R, 2, p) + origin[2]) / _row_dot(R, 2, d)
    if not _NEAREST < t < farthest:
        return math.inf
    q = advance(p, t, d)
    inside = abs(_row_dot(R, 0, q) + origin[0]) <= half[0] and abs(_row_dot(R, 1, q) + origin[1]) <= half[1]
    return t if inside else math.inf


@njit(error_model="numpy")
def _slab(half, o, e):
    """Interval of t within |o + t e| <= half along one axis."""
    if e == 0.0:
        return (-math.inf, math.inf) if abs(o) <= half else (math.inf, -math.inf)
    a, b = (-half - o) / e, (half - o) / e
    return (a, b) if a < b else (b, a)


@njit
def _first_ahead(enter, leave):
    """The nearer end of an interval of t that lies ahead; infinity where the interval is empty or behind."""
    if enter > leave:
        return math.inf
    if enter > _NEAREST:
        return enter
    return leave if leave > _NEAREST else math.inf


@njit
def _hit_box(half, o, e):
    x0, x1 = _slab(half[0], o[0], e[0])
    y0, y1 = _slab(half[1], o[1], e[1])
    z0, z1 = _slab(half[2], o[2], e[2])
    return _first_ahead(max(x0, y0, z0), min(x1, y1, z1))


@njit(error_model="numpy")
def _inside_quadric(a, b, c):
    """Interval of t within a t² + 2 b t + c <= 0, a > 0."""
    discriminant = b * b - a * c
    if discriminant < 0.0:
        return math.inf, -math.inf
    root = math.sqrt(discriminant)
    return (-b - root) / a, (-b + root) / a


@njit
def _hit_sphere(radius, o, e):
    enter, leave = _inside_quadric(dot(e, e), dot(o, e), dot(o, o) - radius * radius)
    return _first_ahead(enter, leave)


@njit(error_model="numpy")
def _hit_cylinder(half, o, e):
    a = e[0] * e[0] + e[1] * e[1]
    c = o[0] * o[0] + o[1] * o[1] - half[0] * half[0]
    side = (-math.inf, math.inf) if c <= 0.0 else (math.inf, -math.inf)
    if a > 1e-12:
        side = _inside_quadric(a, o[0] * e[0] + o[1] * e[1], c)
    z0, z1 = _slab(half[2], o[2], e[2])
    return _first_ahead(max(side[0], z0), min(side[1], z1))


@njit(error_model="numpy")
def _hit_revolved(primitive, o, e):
    c0, c1, c2 = primitive.profile
    half = primitive.half_size[2]
    a = e[0] * e[0] + e[1] * e[1] - c2 * e[2] * e[2]
    b = o[0] * e[0] + o[1] * e[1] - e[2] * (0.5 * c1 + c2 * o[2])
    c = o[0] * o[0] + o[1] * o[1] - (c0 + o[2] * (c1 + c2 * o[2]))
    first, second = _roots(a, b, c)
    side = min(_within(first, o[2], e[2], half), _within(second, o[2], e[2], half))
    upper, lower = c0 + half * (c1 + c2 * half), c0 - half * (c1 - c2 * half)
    return min(side, _hit_disc(half, upper, o, e), _hit_disc(-half, lower, o, e))


@njit(error_model="numpy")
def _roots(a, b, c):
    """Both roots of a t² + 2 b t + c, without cancellation; infinite or NaN where there is none."""
    discriminant = b * b - a * c
    if discriminant < 0.0:
        return math.inf, math.inf
    q = -(b + math.copysign(math.sqrt(discriminant), b))
    return q / a, c / q


@njit
def _within(t, o, e, half):
    """t where it lies ahead and |o + t e| <= half, infinity otherwise."""
    return t if t > _NEAREST and abs(o + t * e) <= half else math.inf


@njit(error_model="numpy")
def _hit_disc(z, squared_radius, o, e):
    t = (z - o[2]) / e[2]
    x, y = o[0] + t * e[0], o[1] + t * e[1]
    return t if t > _NEAREST and x * x + y * y <= squared_radius else math.inf


@njit(error_model="numpy")
def _revolved_normal(primitive, local):
    """Gradient of the surface that the point is nearer to, the side or an end."""
    c0, c1, c2 = primitive.profile
    x, y, z = local
    gradient = (x, y, -0.5 * c1 - c2 * z)
    length = math.sqrt(dot(gradient, gradient))
    from_side = abs(x * x + y * y - (c0 + z * (c1 + c2 * z))) / (2.0 * length)
    if primitive.half_size[2] - abs(z) < from_side:
        return 0.0, 0.0, math.copysign(1.0, z)
    return gradient[0] / length, gradient[1] / length, gradient[2] / length


@njit
def _hit_prism(primitive, o, e, farthest):
    half = primitive.half_size
    x0, x1 = _slab(half[0], o[0], e[0])
    y0, y1 = _slab(half[1], o[1], e[1])
    z0, z1 = _slab(half[2], o[2], e[2])
    enter, leave = max(x0, y0, z0), min(x1, y1, z1)
    if enter > leave or leave < _NEAREST or enter > farthest:
        return math.inf
    if enter > _NEAREST:
        return _newton(primitive, o, e, enter, 1.0)
    distance, _ = _prism_distance(primitive, advance(o, _NEAREST, e))
    if distance > 0.0:
        return _newton(primitive, o, e, _NEAREST, 1.0)
    return _newton(primitive, o, e, leave, -1.0)


@njit(error_model="numpy")
def _newton(primitive, o, e, t, forward):
    """First root of the distance from t on, forwards (1) or backwards (-1), from outside; infinity where none."""
    for _ in range(_NEWTON_STEPS):
        distance, gradient = _prism_distance(primitive, advance(o, t, e))
        if distance < _ON_SURFACE:
            return t if t > _NEAREST else math.inf
        slope = dot(gradient, e)
        if slope * forward >= 0.0:
            return math.inf
        t -= distance / slope
    return math.inf


@njit(error_model="numpy")
def _prism_distance(primitive, q):
    """Signed distance of a rounded prism's surface from a point of its frame, and its gradient."""
    distance, gx, gy = _outline_distance(primitive.outline, primitive.corners, q[0], q[1])
    above = abs(q[2]) - (primitive.half_size[2] - primitive.rounding)
    gz = math.copysign(1.0, q[2])
    if distance > 0.0 and above > 0.0:
        length = math.hypot(distance, above)
        side, end = distance / length, above / length
        return length - primitive.rounding, (gx * side, gy * side, gz * end)
    if distance > above:
        return distance - primitive.rounding, (gx, gy, 0.0)
    return above - primitive.rounding, (0.0, 0.0, gz)


@njit(error_model="numpy")
def _outline_distance(outline, corners, x, y):
    """Signed distance of a point from a convex outline, and its gradient."""
    inside, inside_x, inside_y = -math.inf, 0.0, 0.0  # the nearest edge's line, while the point is inside
    apart, apart_x, apart_y = math.inf, 0.0, 0.0  # the nearest point of an edge or, beyond its ends, corner
    for i in range(corners):
        ax, ay = outline[i]
        bx, by = outline[(i + 1) % corners]
        ux, uy = bx - ax, by - ay
        length = math.hypot(ux, uy)
        nx, ny = uy / length, -ux / length
        height = (x - ax) * nx + (y - ay) * ny
        if height > inside:
            inside, inside_x, inside_y = height, nx, ny
        along = ((x - ax) * ux + (y - ay) * uy) / (length * length)
        if 0.0 <= along <= 1.0:
            if 0.0 < height < apart:
                apart, apart_x, apart_y = height, nx, ny
            continue
        rx, ry = (x - ax, y - ay) if along < 0.0 else (x - bx, y - by)
        corner = math.hypot(rx, ry)
        if 0.0 < corner < apart:
            apart, apart_x, apart_y = corner, rx / corner, ry / corner
    if inside <= 0.0 or apart == math.inf:
        return inside, inside_x, inside_y
    return apart, apart_x, apart_y
