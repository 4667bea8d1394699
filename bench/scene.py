"""Pictures of a disc with exact truth, for measuring how exactly it can be found. Seeded, no code of the gateway.

The disc is a flat one in space, seen through a pinhole: a point of the picture shows it if the ray through that point
meets its plane within its radius. Pixels at the rim are the mean of 10 x 10 such points, others of one. Then come
background, burrs, occluder, dust, lens blur and motion blur as linear mixtures, at last noise and rounding to 8 bits.
"""

from dataclasses import dataclass, field, replace

import cv2
import numpy as np

GRID = 10  # points per pixel side at the rim


@dataclass(frozen=True)
class Truth:
    """The rim's image without distortion: an ellipse; and the image of the disc's own centre."""

    u: float
    v: float
    major: float
    minor: float
    angle: float
    centre_u: float
    centre_v: float


@dataclass(frozen=True)
class Recipe:
    """What is wrong with a picture. Ranges are drawn from uniformly."""

    name: str
    blur: tuple[float, float] = (0.5, 0.9)  # sigma of the lens, px
    noise: float = 0.0
    dust: bool = False
    burrs: bool = False
    occluded: float = 0.0  # share of the rim
    tilt_deg: float = 0.0  # at most
    truncated: bool = False
    motion: float = 0.0  # length of the path, share of R, at most
    gamma: bool = False  # mixed in linear light, stored as sRGB
    texture: float = 0.0  # contrast of the background, grey levels
    limit: float = 0.05  # px, what centre and radius are to keep in 95 % of the pictures


ALL = Recipe("all together", blur=(0.5, 1.0), noise=5.0, dust=True, burrs=True, occluded=0.3, tilt_deg=30.0)
RECIPES = (
    Recipe("clean", blur=(0.0, 0.0)),
    Recipe("blurred", blur=(0.8, 3.0)),
    Recipe("noisy", noise=10.0),
    Recipe("dusty", noise=3.0, dust=True),
    Recipe("burrs", noise=3.0, burrs=True),
    Recipe("occluded", noise=3.0, occluded=0.3),
    Recipe("tilted", noise=3.0, tilt_deg=30.0),
    Recipe("truncated", noise=3.0, truncated=True, limit=0.3),
    ALL,
)
"""What was asked for."""
BEYOND = (
    Recipe("moving", noise=3.0, motion=0.08),
    Recipe("textured", noise=3.0, texture=40.0),
    Recipe("gamma", blur=(0.5, 1.5), gamma=True, noise=3.0),
    replace(ALL, name="all, noise 10", blur=(0.6, 1.5), noise=10.0),
    replace(ALL, name="all, textured", texture=20.0),
    replace(ALL, name="all, truncated", occluded=0.15, truncated=True, limit=0.3),
)
"""What else a camera meets."""


@dataclass(frozen=True)
class Scene:
    """Everything drawn at random, so that the same picture can be rendered with a slightly different disc."""

    recipe: Recipe
    width: int
    height: int
    focal: float
    rotation: np.ndarray  # (3, 3): columns 0, 1 span the disc's plane, 2 is its normal
    position: np.ndarray  # (3,): of the disc's centre, in disc radii
    distortion: tuple[float, ...]
    red: np.ndarray
    ground: np.ndarray  # (H, W, 3) or (3,)
    blur: float
    motion: tuple[float, float]  # path of the motion, px
    burrs: np.ndarray  # (n, 3): angle, half width (rad), height (share of R)
    blocker: tuple[np.ndarray, np.ndarray] | None  # coverage (H, W), colour
    dust: tuple[np.ndarray, np.ndarray] | None  # coverage (H, W), colour
    seed: int = 0
    extra: dict[str, float] = field(default_factory=dict)

    @property
    def camera(self) -> np.ndarray:
        return np.array([[self.focal, 0, self.width / 2], [0, self.focal, self.height / 2], [0, 0, 1.0]])

    def truth(self) -> Truth:
        """By the projection of the conic, not by anything the gateway has: C_image = H^-T diag(1, 1, -1) H^-1."""
        plane = self.camera @ np.column_stack([self.rotation[:, 0], self.rotation[:, 1], self.position])
        back = np.linalg.inv(plane)
        conic = back.T @ np.diag([1.0, 1.0, -1.0]) @ back
        centre = np.linalg.solve(conic[:2, :2], -conic[:2, 2])
        level = conic[:2, 2] @ centre + conic[2, 2]
        values, vectors = np.linalg.eigh(-conic[:2, :2] / level)
        axes = 1 / np.sqrt(values)
        along = vectors[:, 0]
        own = self.project(self.position[np.newaxis])[0]
        return Truth(
            float(centre[0]),
            float(centre[1]),
            float(axes[0]),
            float(axes[1]),
            float(np.arctan2(along[1], along[0]) % np.pi),
            float(own[0]),
            float(own[1]),
        )

    def project(self, points: np.ndarray) -> np.ndarray:
        still = np.zeros(3)
        lens = np.array(self.distortion or (0.0, 0.0, 0.0, 0.0))
        return cv2.projectPoints(points.reshape(-1, 1, 3), still, still, self.camera, lens)[0].reshape(-1, 2)

    def moved(self, du: float = 0.0, dv: float = 0.0, scale: float = 1.0) -> "Scene":
        """The disc shifted by (du, dv) px in the picture and `scale` times as large; all else stays."""
        shift = np.array([du, dv, 0.0]) * self.position[2] / self.focal
        # As large again at the same place: nearer, with the viewing ray kept.
        return replace(self, position=(self.position + shift) / scale)

    def _inside(self, points: np.ndarray) -> np.ndarray:
        """Signed excess of points (..., 2) px over the rim, in disc radii: negative inside."""
        if self.distortion:
            flat = cv2.undistortPoints(
                points.reshape(-1, 1, 2).astype(np.float64),
                self.camera,
                np.array(self.distortion),
                criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-10),
            ).reshape(points.shape)
        else:
            flat = (points - (self.width / 2, self.height / 2)) / self.focal
        rays = np.concatenate([flat, np.ones((*flat.shape[:-1], 1))], axis=-1)
        normal = self.rotation[:, 2]
        depth = (self.position @ normal) / (rays @ normal)
        on_plane = (rays * depth[..., np.newaxis] - self.position) @ self.rotation[:, :2]
        radius = np.hypot(on_plane[..., 0], on_plane[..., 1])
        limit = np.ones_like(radius)
        if len(self.burrs):
            angle = np.arctan2(on_plane[..., 1], on_plane[..., 0])
            for at, half, high in self.burrs:
                apart = np.abs((angle - at + np.pi) % (2 * np.pi) - np.pi) / half
                limit = limit + high * np.clip(1 - apart * apart, 0, None)
        return np.asarray(radius - limit)

    def coverage(self) -> np.ndarray:
        """(H, W) in 0 to 1: how much of every pixel the disc covers."""
        v, u = np.mgrid[0 : self.height, 0 : self.width].astype(np.float64)
        excess = self._inside(np.stack([u, v], axis=-1))
        cover = (excess <= 0).astype(np.float64)
        span = 1.2 / self.truth().minor
        if len(self.burrs):
            full = cv2.dilate(cover, np.ones((5, 5))) - cv2.erode(cover, np.ones((5, 5)))
            rows, columns = np.nonzero((full > 0) | (np.abs(excess) < span))
        else:
            rows, columns = np.nonzero(np.abs(excess) < span)
        inner = (np.arange(GRID) + 0.5) / GRID - 0.5
        points = np.empty((len(rows), GRID, GRID, 2))
        points[..., 0] = columns[:, None, None] + inner[None, None, :]
        points[..., 1] = rows[:, None, None] + inner[None, :, None]
        cover[rows, columns] = (self._inside(points) <= 0).mean(axis=(1, 2))
        return cover.astype(np.float32)

    def clear(self) -> np.ndarray:
        """The picture before noise and rounding: (H, W, 3) float, BGR, 0 to 255."""
        cover = self.coverage()[..., np.newaxis]
        ground = self.ground.astype(np.float32)
        picture = ground + cover * (self.red.astype(np.float32) - ground)
        for layer in (self.blocker, self.dust):
            if layer is not None:
                picture = picture + layer[0].astype(np.float32)[..., np.newaxis] * (
                    layer[1].astype(np.float32) - picture
                )
        if self.recipe.gamma:
            picture = _from_srgb(picture)
        if self.blur > 0:
            picture = cv2.GaussianBlur(picture, (0, 0), self.blur, borderType=cv2.BORDER_REFLECT_101)
        path = float(np.hypot(*self.motion))
        if path > 0:
            picture = _smear(picture, self.motion)
        return _to_srgb(picture) if self.recipe.gamma else picture

    def shot(self) -> np.ndarray:
        picture = self.clear()
        if self.recipe.noise:
            noise = np.random.default_rng(self.seed).standard_normal(picture.shape, np.float32)
            picture = picture + np.float32(self.recipe.noise) * noise
        return np.asarray(np.clip(np.rint(picture), 0, 255), np.uint8)


def _from_srgb(picture: np.ndarray) -> np.ndarray:
    x = np.clip(picture / 255, 0, 1)
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4) * 255


def _to_srgb(picture: np.ndarray) -> np.ndarray:
    x = np.clip(picture / 255, 0, 1)
    return np.where(x <= 0.0031308, x * 12.92, 1.055 * x ** (1 / 2.4) - 0.055) * 255


def _smear(picture: np.ndarray, motion: tuple[float, float]) -> np.ndarray:
    """The mean along a straight path of `motion` (du, dv) px that is centred on where things stand at mid-exposure."""
    steps = 2 * int(np.ceil(np.hypot(*motion) * 2)) + 1
    half = int(np.ceil(max(abs(motion[0]), abs(motion[1])) / 2)) + 1
    kernel = np.zeros((2 * half + 1, 2 * half + 1))
    for part in (np.arange(steps) + 0.5) / steps - 0.5:
        u, v = part * motion[0] + half, part * motion[1] + half
        left, top = int(u), int(v)
        fu, fv = u - left, v - top
        kernel[top : top + 2, left : left + 2] += np.outer([1 - fv, fv], [1 - fu, fu])
    return cv2.filter2D(picture, -1, kernel / kernel.sum(), borderType=cv2.BORDER_REFLECT_101)


def draw(recipe: Recipe, seed: int, radius: tuple[float, float] = (45.0, 250.0)) -> Scene:
    """One scene of a recipe; the radius (semi-major axis) is spread evenly over the logarithm."""
    rng = np.random.default_rng([seed, sum(map(ord, recipe.name))])
    size = float(np.exp(rng.uniform(*np.log(radius))))
    wide = int(2.4 * size) + 24
    u, v = wide / 2 + rng.uniform(-4, 4), wide / 2 + rng.uniform(-4, 4)
    if recipe.truncated:
        # A border of the frame takes 10 to 40 % of the disc's diameter.
        cut = rng.uniform(0.1, 0.4) * 2 * size
        side = rng.integers(4)
        near = size - cut
        u, v = [(near, v), (wide - 1 - near, v), (u, near), (u, wide - 1 - near)][side]
    tilt, toward = np.radians(rng.uniform(0, recipe.tilt_deg)), rng.uniform(0, 2 * np.pi)
    focal = rng.uniform(1.2, 2.5) * wide
    position = np.array([(u - wide / 2) / focal, (v - wide / 2) / focal, 1.0]) * focal / size
    axis = np.array([-np.sin(toward), np.cos(toward), 0.0])
    turn = cv2.Rodrigues(axis * tilt)[0]
    burrs = np.zeros((0, 3))
    if recipe.burrs:
        count = rng.integers(3, 8)
        heights = rng.uniform(0.02, 0.12, count) * rng.choice([-1, 1, 1, 1], count)
        burrs = np.stack([rng.uniform(-np.pi, np.pi, count), rng.uniform(0.02, 0.12, count), heights], axis=1)
    grey = rng.uniform(70, 190)
    ground = np.clip(grey + rng.normal(0, 12, 3), 0, 255)
    if recipe.texture:
        ground = np.clip(ground + _clouds(rng, wide, (2, 6, 20, 60))[..., np.newaxis] * recipe.texture, 0, 255)
    red = np.array([rng.uniform(10, 70), rng.uniform(10, 60), rng.uniform(140, 235)])
    path = rng.uniform(0, recipe.motion) * size
    heading = rng.uniform(0, 2 * np.pi)
    scene = Scene(
        recipe=recipe,
        width=wide,
        height=wide,
        focal=focal,
        rotation=turn,
        position=position,
        distortion=(),
        red=red,
        ground=ground,
        blur=rng.uniform(*recipe.blur),
        motion=(path * np.cos(heading), path * np.sin(heading)),
        burrs=burrs,
        blocker=_blocker(rng, wide, u, v, size, recipe.occluded) if recipe.occluded else None,
        dust=_dust(rng, wide) if recipe.dust else None,
        seed=seed,
    )
    # The tilt changes the size a little: scale it so that the semi-major axis is what was drawn.
    return scene.moved(scale=size / scene.truth().major)


def _clouds(rng: np.random.Generator, wide: int, sizes: tuple[float, ...]) -> np.ndarray:
    """(H, W) texture of mean 0 and deviation 1 with structure of several sizes, px."""
    total = np.zeros((wide, wide))
    for size in sizes:
        small = max(int(wide / size), 3)
        total += cv2.resize(rng.normal(0, 1, (small, small)), (wide, wide), interpolation=cv2.INTER_CUBIC)
    return np.asarray((total - total.mean()) / total.std())


def _blocker(
    rng: np.random.Generator, wide: int, u: float, v: float, size: float, share: float
) -> tuple[np.ndarray, np.ndarray]:
    """One to three dull wedges, anti-aliased, that hide `share` of the rim together."""
    pieces = rng.integers(1, 4)
    shares = rng.dirichlet(np.full(pieces, 4.0)) * share
    starts = rng.uniform(0, 2 * np.pi) + np.arange(pieces) * 2 * np.pi / pieces
    fine = 4
    cover = np.zeros((wide * fine, wide * fine), np.uint8)
    for start, part in zip(starts, shares, strict=True):
        angles = start + np.linspace(0, 2 * np.pi * part, 24)
        outer = np.stack([u + 1.6 * size * np.cos(angles), v + 1.6 * size * np.sin(angles)], axis=1)
        inner = np.stack([u + 0.6 * size * np.cos(angles[::-1]), v + 0.6 * size * np.sin(angles[::-1])], axis=1)
        polygon = (np.concatenate([outer, inner]) + 0.5) * fine - 0.5
        cv2.fillPoly(cover, [np.rint(polygon * 16).astype(np.int32)], 255, shift=4)
    soft = cv2.resize(cover.astype(np.float64) / 255, (wide, wide), interpolation=cv2.INTER_AREA)
    return soft, np.clip(rng.uniform(20, 140) + rng.normal(0, 15, 3), 0, 255)


def _dust(rng: np.random.Generator, wide: int) -> tuple[np.ndarray, np.ndarray]:
    """A veil of 10 to 45 % with clouds in it, and specks: some two on every thousand pixels."""
    veil = np.clip(rng.uniform(0.1, 0.45) + 0.08 * _clouds(rng, wide, (30, 90)), 0.0, 0.7)
    fine = 4
    specks = np.zeros((wide * fine, wide * fine), np.uint8)
    for _ in range(int(wide * wide * 0.002)):
        at = rng.uniform(0, wide * fine, 2)
        half = rng.uniform(0.5, 2.0, 2) * fine
        cv2.ellipse(
            specks,
            (np.round(at * 16).astype(int).tolist()),
            np.round(half * 16).astype(int).tolist(),
            rng.uniform(0, 180),
            0,
            360,
            255,
            -1,
            cv2.LINE_AA,
            4,
        )
    spots = cv2.resize(specks.astype(np.float64) / 255, (wide, wide), interpolation=cv2.INTER_AREA)
    return 1 - (1 - veil) * (1 - 0.8 * spots), np.array([150.0, 165.0, 172.0])
