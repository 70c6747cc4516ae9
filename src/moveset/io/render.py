"""Pictures of a motion: an orthographic ray caster for the body of ``io.body``, a floor, a shadow and a trail.

Seen without perspective, everything that a round cone needs (where a ray meets it, how deep, which way the surface
faces) is a polynomial in the two pixel coordinates, so a part costs a few array operations on the pixels it covers.
View axes: x right, y up, z towards the viewer, metres from the point looked at. P parts, F frames.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from PIL import Image, ImageDraw, ImageFilter, ImageFont

from moveset.io.body import Part, human_body
from moveset.motion import rotations
from moveset.motion.clip import Motion

BACKGROUND = (244, 245, 247)
INK = (44, 50, 60)
TRAIL = (120, 108, 196)
_TONES = {"left": (238, 124, 84), "right": (58, 134, 190), "trunk": (222, 219, 212), "face": (52, 58, 70)}
_TILE, _MEMORY = 0.5, 4.0
_OVERSAMPLING = 2
_LIGHT = np.array((-0.38, 0.72, 0.58)) / np.linalg.norm((-0.38, 0.72, 0.58))
_PITCH, _AZIMUTH = 13.0, 48.0


@cache
def font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """Pillow's own font, which needs no files on the machine."""
    return ImageFont.load_default(size)


def fitted(text: str, size: int, room: float, lines: int = 1) -> str:
    """A text of at most ``lines`` lines of ``room`` pixels, broken between words, cut with an ellipsis if need be."""
    words = text.split()[:200]
    done: list[str] = []
    while words:
        count = len(words)
        while count > 1 and font(size).getlength(" ".join(words[:count])) > room:
            count -= 1
        line, words = " ".join(words[:count]), words[count:]
        last = len(done) == lines - 1
        if (last and words) or font(size).getlength(line) > room:
            while line and font(size).getlength(line + "…") > room:
                line = line[:-1]
            line += "…"
        done.append(line)
        if last:
            break
    return "\n".join(done)


@dataclass(frozen=True, eq=False)
class View:
    """Where the camera stands and what a picture measures.

    Args:
        width, height: pixels.
        scale: pixels a metre.
        axes: (3, 3), rows: world directions to the right, up, and towards the viewer.
        targets: (F, 3) world point in the centre of each picture.
    """

    width: int
    height: int
    scale: float
    axes: np.ndarray
    targets: np.ndarray


def three_quarter_view(
    motion: Motion, width: int, height: int, *, frames: Sequence[int] | None = None, below: int = 0
) -> View:
    """From the right and in front of where the body faces first, so that a walk comes nearer and goes to the right.

    The camera follows the root over the ground, smoothly enough not to nod with each step; the zoom keeps the body
    inside the picture all the time.

    Args:
        motion: what is looked at.
        width, height: pixels.
        frames: a view of these frames only, for stills: each with its body in the middle.
        below: rows of pixels kept free of the body at the bottom, for a caption.
    """
    facing = float(rotations.heading_angle(motion.rotations[0, 0]))
    turn, pitch = facing - np.radians(_AZIMUTH), np.radians(_PITCH)
    toward = np.array((np.sin(turn) * np.cos(pitch), np.sin(pitch), np.cos(turn) * np.cos(pitch)))
    right = np.array((np.cos(turn), 0.0, -np.sin(turn)))
    axes = np.stack((right, np.cross(toward, right), toward))

    targets = motion.joints[:, 0].numpy().astype(np.float64) * (1.0, 0.0, 1.0)
    targets = _smoothed(targets, 0.35 * motion.fps) if frames is None else targets[list(frames)]
    view = View(width, height, 1.0, axes, targets)
    shapes = _shapes(human_body(motion.skeleton), motion, view, frames)
    low, high = shapes.low[..., :2].min(axis=1), shapes.high[..., :2].max(axis=1)
    if frames is not None:
        aside = 0.5 * (low[:, :1] + high[:, :1])
        targets += aside * right
        low[:, :1] -= aside
        high[:, :1] -= aside
    bottom, top = float(low[:, 1].min()), float(high[:, 1].max())
    reach = max(float(-low[:, 0].min()), float(high[:, 0].max()))
    room = height - below
    scale = min(0.46 * width / reach, 0.92 * room / (top - bottom), 1.2 * room)
    targets[:, 1] = (0.5 * (bottom + top) - 0.5 * below / scale) / axes[1, 1]
    return replace(view, scale=scale)


def _smoothed(path: np.ndarray, sigma: float) -> np.ndarray:
    """Gaussian average along dimension 0, the ends held."""
    reach = max(1, int(3 * sigma))
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / max(sigma, 1e-6)) ** 2)
    padded = np.pad(path, ((reach, reach), (0, 0)), mode="edge")
    return np.stack([np.convolve(column, kernel / kernel.sum(), mode="valid") for column in padded.T], axis=1)


class Painter:
    """Draws the frames of one motion as one view shows them.

    Args:
        motion: what to draw.
        view: a camera for all its frames, or for the chosen ones.
        frames: the chosen ones.
    """

    def __init__(self, motion: Motion, view: View, frames: Sequence[int] | None = None) -> None:
        self.view = view
        self.frames = list(frames) if frames is not None else list(range(len(motion)))
        parts = human_body(motion.skeleton)
        ramp = np.linspace(0.0, 1.25, 256)[:, None]
        self.shades = [np.minimum(ramp * _TONES[part.tone], 255.0) for part in parts]
        self.shapes = _shapes(parts, motion, view, frames)
        self.trail = motion.joints[:, 0].numpy().astype(np.float64) * (1.0, 0.0, 1.0)
        self.memory = int(_MEMORY * motion.fps)
        self._light = _LIGHT @ view.axes
        self._floor = _floor(view)

    def frame(self, index: int) -> Image.Image:
        """The RGB picture of one frame; ``index`` counts the chosen frames."""
        picture = self._ground(index)
        self._body(picture, index)
        return picture

    def _ground(self, index: int) -> Image.Image:
        """A floor grid, fixed to the world and fading with distance, under the body's shadow and trail."""
        view, floor = self.view, self._floor
        size = view.width, view.height
        dark = np.zeros_like(floor.fade)
        for axis, grid, step in ((0, floor.x, floor.step[0]), (2, floor.z, floor.step[1])):
            away = grid + np.float32(view.targets[index, axis] / _TILE)
            away -= np.rint(away)
            np.abs(away, out=away)
            away *= np.float32(-_TILE / step)
            np.maximum(dark, away + np.float32(1.15), out=dark)
        np.minimum(dark, 1.0, out=dark)
        dark *= floor.fade
        mask = self._shadow(index).resize(size, Image.Resampling.BILINEAR)
        dark += np.asarray(mask)
        ground = Image.new("RGB", size, BACKGROUND)
        ground.paste((0, 0, 0), mask=Image.fromarray(dark.astype(np.uint8)))
        now = self.frames[index] + 1
        path = self.trail[max(0, now - self.memory) : now]
        if np.ptp(path, axis=0).max() > 0.3:
            path = (path - view.targets[index]) @ view.axes[:2].T
            # Drawn twice as large and halved, for smooth edges.
            points = 2.0 * path * (view.scale, -view.scale) + size
            mask = Image.new("L", (2 * view.width, 2 * view.height))
            ImageDraw.Draw(mask).line(points.ravel().tolist(), fill=210, width=5)
            ground.paste(TRAIL, mask=mask.reduce(2))
        return ground

    def _shadow(self, index: int) -> Image.Image:
        """The body's shadow, at half the size, soft-edged, as a mask."""
        view, shapes = self.view, self.shapes
        mask = Image.new("L", (view.width // 2, view.height // 2))
        draw = ImageDraw.Draw(mask)
        scale = 0.5 * view.scale
        centre = 0.5 * np.array(mask.size)
        fallen = shapes.balls[index] - shapes.balls[index, :, 1:2] * (self._light / self._light[1])
        at = (fallen - view.targets[index]) @ view.axes[:2].T * (scale, -scale) + centre
        reach = shapes.ball_radii[:, None] * scale * (1.0, view.axes[2, 1])
        for box in np.concatenate((at - reach, at + reach), axis=1).tolist():
            draw.ellipse(box, fill=70)
        return mask.filter(ImageFilter.GaussianBlur(1.2))

    def _body(self, picture: Image.Image, index: int) -> None:
        """Paint the body over a picture: every part where it is nearest, in fine pixels that are then averaged."""
        view, shapes, fine = self.view, self.shapes, _OVERSAMPLING
        low, high = shapes.low[index], shapes.high[index]
        middle = 0.5 * np.array((view.width, view.height))
        corners = np.array(((low[:, 0].min(), -high[:, 1].max()), (high[:, 0].max(), -low[:, 1].min())))
        (left, top), (right, bottom) = np.clip(corners * view.scale + middle + ((-1,), (2,)), 0, 2 * middle).astype(int)
        if left >= right or top >= bottom:
            return
        x = ((np.arange(left * fine, right * fine) + 0.5) / fine - middle[0]) / view.scale
        y = (middle[1] - (np.arange(top * fine, bottom * fine) + 0.5) / fine) / view.scale
        columns = np.searchsorted(x, np.stack((low[:, 0], high[:, 0]), axis=1))
        rows = np.searchsorted(-y, np.stack((-high[:, 1], -low[:, 1]), axis=1))
        x, y = x.astype(np.float32), y.astype(np.float32)
        nearest = np.full((len(y), len(x)), -np.inf, dtype=np.float32)
        colour = np.zeros((len(y), len(x)), dtype=np.uint32)
        for part in np.argsort(-shapes.depth[index]):
            area = slice(*rows[part]), slice(*columns[part])
            if len(nearest[area]) and nearest[area].shape[1]:
                ramp = _ramp(self.shades[part], shapes.depth[index, part])
                _paint(shapes, index, part, x[area[1]], y[area[0]], nearest[area], colour[area], ramp)
        body = Image.fromarray(colour.view(np.uint8).reshape(*colour.shape, 4)).reduce(fine)
        picture.paste(body, (int(left), int(top)), mask=body)


def _ramp(shades: np.ndarray, depth: float) -> np.ndarray:
    """(256,) RGBA packed in 32 bits, from dark to bright; parts farther away fade towards the background."""
    haze = min(max(0.08 - 0.4 * depth, 0.0), 0.30)
    packed = np.full((256, 4), 255, dtype=np.uint8)
    packed[:, :3] = shades + haze * (np.array(BACKGROUND) - shades)
    return packed.view(np.uint32)[:, 0]


@dataclass(frozen=True, eq=False)
class _Floor:
    """Floor under the pixels: world x, z (H, W) in tiles from the target; metres a pixel; darkness of lines (H, W)."""

    x: np.ndarray
    z: np.ndarray
    step: tuple[float, float]
    fade: np.ndarray


def _floor(view: View) -> _Floor:
    x = (np.arange(view.width) + 0.5 - 0.5 * view.width) / view.scale
    y = (0.5 * view.height - np.arange(view.height) - 0.5) / view.scale
    right, up, toward = view.axes
    height = float(view.targets[0, 1])
    # A ray meets the floor where height + y·up_y + d·toward_y = 0.
    d = -(height + y * up[1]) / toward[1]
    at = x[None, :, None] * right + (y[:, None] * up + d[:, None] * toward)[:, None]
    slope = up - up[1] / toward[1] * toward
    step = tuple(float(np.hypot(right[k], slope[k])) / view.scale for k in (0, 2))
    distance = np.hypot(at[..., 0], at[..., 2])
    fade = np.exp(-((distance / 2.6) ** 2))
    x, z = ((at[..., k] / _TILE).astype(np.float32) for k in (0, 2))
    return _Floor(x, z, (step[0], step[1]), (50.0 * fade).astype(np.float32))


@dataclass(frozen=True, eq=False)
class _Shapes:
    """What ``_paint`` needs of every part in every frame, all (F, P, …): see ``_shapes``."""

    low: np.ndarray
    high: np.ndarray
    depth: np.ndarray
    inverse: np.ndarray
    rays: np.ndarray
    axis: np.ndarray
    radii: np.ndarray
    balls: np.ndarray
    ball_radii: np.ndarray


def _shapes(parts: tuple[Part, ...], motion: Motion, view: View, frames: Sequence[int] | None) -> _Shapes:
    """Parts of all or some frames in view coordinates.

    A part's own coordinates q follow from view coordinates v by q = B (v - c). ``inverse`` holds B; ``rays`` holds the
    columns u, v, w, e of q - start = u x + v y + w + e z, z being the depth.
    """
    owner = [part.joint for part in parts]
    start, end = (np.stack([getattr(part, name) for part in parts]) for name in ("start", "end"))
    radii = np.array([part.radii for part in parts])
    chosen = slice(None) if frames is None else list(frames)
    turned = rotations.to_matrix(motion.global_rotations[chosen][:, owner])
    place = motion.joints[chosen][:, owner].numpy().astype(np.float64)
    to_world = turned.numpy().astype(np.float64) @ np.stack([part.frame for part in parts])
    to_view = view.axes @ to_world
    centre = (place - view.targets[:, None]) @ view.axes.T
    inverse = np.linalg.inv(to_view)
    w = -np.einsum("fpij,fpj->fpi", inverse, centre) - start
    rays = np.concatenate((inverse[..., :2], w[..., None], inverse[..., 2:]), axis=-1)
    ends = [centre + np.einsum("fpij,pj->fpi", to_view, q) for q in (start, end)]
    spread = [np.linalg.norm(to_view, axis=-1) * radii[:, k, None] for k in (0, 1)]
    balls, ball_radii = [], []
    for share in (0.0, 0.25, 0.5, 0.75, 1.0):
        q = start + share * (end - start)
        balls.append(place + np.einsum("fpij,pj->fpi", to_world, q))
        ball_radii.append(radii @ (1.0 - share, share))
    return _Shapes(
        low=np.minimum(ends[0] - spread[0], ends[1] - spread[1]),
        high=np.maximum(ends[0] + spread[0], ends[1] + spread[1]),
        depth=0.5 * (ends[0] + ends[1])[..., 2],
        inverse=inverse,
        rays=rays,
        axis=end - start,
        radii=radii,
        balls=np.concatenate(balls, axis=1),
        ball_radii=np.concatenate(ball_radii),
    )


def _paint(
    shapes: _Shapes,
    index: int,
    part: int,
    x: np.ndarray,
    y: np.ndarray,
    nearest: np.ndarray,
    colour: np.ndarray,
    ramp: np.ndarray,
) -> None:
    """Ray-cast one round cone into a rectangle of the depth and colour buffers (H, W); ``ramp``: colours by brightness.

    The intersection is Quilez's (iquilezles.org, "round cone"), with its terms gathered into polynomials of x and y.
    """
    u, v, w, e = shapes.rays[index, part].T
    axis, (ra, rb) = shapes.axis[part], shapes.radii[part]
    length = float(np.sqrt(e @ e))
    ray = -e / length
    rr = ra - rb
    m0, m2 = float(axis @ axis), float(axis @ ray)
    d2 = m0 - rr * rr
    m1 = np.array((axis @ u, axis @ v, axis @ w))
    m3 = np.array((ray @ u, ray @ v, ray @ w))
    square = np.array((u @ u, v @ v, 2 * (u @ v), 2 * (u @ w), 2 * (v @ w), w @ w))

    ball_a = _squared(m3) - square + (0, 0, 0, 0, 0, ra * ra)
    m6 = m3 - (0.0, 0.0, m2)
    ball_b = _squared(m6) - square + 2.0 * _linear(m1) + (0, 0, 0, 0, 0, rb * rb - m0)
    t = _entry(_plane(m3, x, y), _quadratic(ball_a, x, y), 1.0)
    np.minimum(t, _entry(_plane(m6, x, y), _quadratic(ball_b, x, y), 1.0), out=t)
    k2 = d2 - m2 * m2
    if d2 > 0.0 and abs(k2) > 1e-6 * m0:
        k1 = d2 * m3 - m2 * m1 + (0.0, 0.0, m2 * rr * ra)
        k0 = d2 * square - _squared(m1) + 2.0 * rr * ra * _linear(m1) - (0, 0, 0, 0, 0, m0 * ra * ra)
        side = _entry(_plane(k1, x, y), _quadratic(_squared(k1) - k2 * k0, x, y), k2)
        along = _plane(m1 - (0.0, 0.0, ra * rr), x, y) + np.float32(m2) * side
        # Comparing with NaN and infinity is False, as it should be where the ray misses the cone.
        np.minimum(t, np.where((along > 0.0) & (along < d2), side, np.inf), out=t)

    t *= np.float32(-1.0 / length)
    hit = t > nearest
    np.copyto(nearest, t, where=hit)
    depth = t[hit]
    if not len(depth):
        return
    points = np.ones((4, len(depth)), dtype=np.float32)
    points[0] = np.broadcast_to(x, hit.shape)[hit]
    points[1] = np.broadcast_to(y[:, None], hit.shape)[hit]
    points[3] = depth
    # The surface faces away from the nearest sphere of those that sweep the cone out; the rows of ``facing`` give that
    # direction for the first sphere and, last, how far along the axis the sphere lies.
    back = shapes.inverse[index, part].T
    rays = shapes.rays[index, part]
    facing = np.concatenate((back @ rays, axis[None] @ rays)).astype(np.float32) @ points
    along = np.clip((facing[3] - np.float32(ra * rr)) * np.float32(1.0 / max(d2, 1e-9)), 0.0, 1.0)
    normal = facing[:3] - (back @ axis).astype(np.float32)[:, None] * along
    size = np.sqrt(np.einsum("ij,ij->j", normal, normal))
    lit = (_LIGHT.astype(np.float32) @ normal) / size
    bright = np.maximum(normal[2] / size, 0.0) * np.float32(45.0)
    lit *= 0.5
    lit += 0.5
    bright += np.float32(85.0) * lit * lit
    bright += np.float32(90.0)
    colour[hit] = ramp[bright.astype(np.uint8)]


def _linear(p: np.ndarray) -> np.ndarray:
    """Coefficients of x², y², xy, x, y, 1 of a plane's p0 x + p1 y + p2."""
    return np.array((0.0, 0.0, 0.0, p[0], p[1], p[2]))


def _squared(p: np.ndarray) -> np.ndarray:
    """Coefficients of x², y², xy, x, y, 1 of (p0 x + p1 y + p2)²."""
    a, b, c = p
    return np.array((a * a, b * b, 2 * a * b, 2 * a * c, 2 * b * c, c * c))


def _plane(p: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    a, b, c = p.astype(np.float32)
    out: np.ndarray = (b * y + c)[:, None] + a * x
    return out


def _quadratic(p: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    xx, yy, xy, x1, y1, c = p.astype(np.float32)
    out: np.ndarray = y[:, None] * (xy * x) + ((yy * y + y1) * y + c)[:, None] + (xx * x + x1) * x
    return out


def _entry(half_b: np.ndarray, discriminant: np.ndarray, a: float) -> np.ndarray:
    """Distance at which a ray enters: the smaller root of a t² + 2 b t + c; infinite where there is none."""
    missed = discriminant < 0.0
    np.maximum(discriminant, 0.0, out=discriminant)
    np.sqrt(discriminant, out=discriminant)
    discriminant += half_b
    discriminant *= np.float32(-1.0 / a)
    discriminant[missed] = np.inf
    return discriminant
