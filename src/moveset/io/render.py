"""Pictures of a motion: the body of ``io.body`` on a tiled floor, with its shadow and its trail. F frames."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from PIL import Image, ImageDraw, ImageFilter, ImageFont

from moveset.io.body import human_body
from moveset.io.raycast import LIGHT, paint, posed_shapes
from moveset.motion import rotations
from moveset.motion.clip import Motion

BACKGROUND = (244, 245, 247)
INK = (44, 50, 60)
TRAIL = (120, 108, 196)
_TONES = {"left": (238, 124, 84), "right": (58, 134, 190), "trunk": (222, 219, 212), "face": (52, 58, 70)}
_TILE, _MEMORY = 0.5, 4.0
_OVERSAMPLING = 2
_PITCH, _AZIMUTH = 13.0, 48.0


@cache
def font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """Pillow's own font, which needs no files on the machine."""
    return ImageFont.load_default(size)


def fitted(text: str, size: int, room: float, lines: int = 1) -> str:
    """A text of at most ``lines`` lines of ``room`` pixels, broken between words, cut with an ellipsis if need be."""
    # More than fits anywhere: what a file remembers may be of any length, and text is measured letter by letter.
    words = [word[:500] for word in text.split()[:200]]
    done: list[str] = []
    while words:
        count = 1
        while count < len(words) and font(size).getlength(" ".join(words[: count + 1])) <= room:
            count += 1
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
    shapes = posed_shapes(human_body(motion.skeleton), motion, axes, targets, frames)
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
        view: a camera for all its frames, or for the chosen ones.
    """

    def __init__(self, motion: Motion, view: View, frames: Sequence[int] | None = None) -> None:
        self.view = view
        self.frames = list(frames) if frames is not None else list(range(len(motion)))
        parts = human_body(motion.skeleton)
        ramp = np.linspace(0.0, 1.25, 256)[:, None]
        self.shades = [np.minimum(ramp * _TONES[part.tone], 255.0) for part in parts]
        self.shapes = posed_shapes(parts, motion, view.axes, view.targets, frames)
        self.trail = motion.joints[:, 0].numpy().astype(np.float64) * (1.0, 0.0, 1.0)
        self.memory = max(1, int(_MEMORY * motion.fps))
        self._light = LIGHT @ view.axes
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
        with np.errstate(invalid="ignore"):
            for part in np.argsort(-shapes.depth[index]):
                area = slice(*rows[part]), slice(*columns[part])
                if nearest[area].size:
                    ramp = _ramp(self.shades[part], shapes.depth[index, part])
                    paint(shapes, index, part, x[area[1]], y[area[0]], nearest[area], colour[area], ramp)
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
