"""The net that proposes: what its seeds are, that they only propose, and what happens without its file."""

import math
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway import config_check
from gateway.config import VisionConfig, parse
from gateway.errors import ConfigError
from gateway.sim.render import render
from gateway.sim.scenario import Pose, Scenario
from gateway.sim.world import World
from gateway.vision.detect.robust import proposer, proposer_file, search
from gateway.vision.detect.robust.candidates import Seed
from gateway.vision.detect.robust.detect import FullFrameDetector, detect, limits_of
from gateway.vision.detect.robust.redness import pyramid
from gateway.vision.detect.robust.roi_search import RoiSearch
from gateway.vision.pixels import Image
from tests import decoys, discs
from training.scene import HEIGHT, WIDTH, Scene
from training.scenes import scenes
from training.source import source_sum
from training.weather import part, weathered

LEARNED, BOTH = VisionConfig(proposals="learned"), VisionConfig(proposals="both")


def seeds_of(image: Image) -> list[Seed]:
    return proposer.shipped()(pyramid(image, 1, 8))


def veiled(image: Image, share: float) -> Image:
    return discs.rounded(image * (1 - share) + share * np.array([206.0, 206.0, 204.0]))


class Answer:
    """Stands in for OpenCV's net: one centre, the same for every picture."""

    def __init__(self, row: int, column: int, du: float, dv: float, radius: float) -> None:
        self._maps = np.zeros((1, 4, 32, 40), np.float32)
        self._maps[0, :, row, column] = 0.75, du, dv, math.log(radius / proposer.RADIUS_PX)
        self.seen: np.ndarray | None = None

    def setInput(self, blob: np.ndarray) -> None:
        self.seen = blob

    def forward(self) -> np.ndarray:
        return self._maps


def test_the_shipped_file_is_small_and_the_one_that_was_trained() -> None:
    data = proposer_file.read()
    assert len(data) <= 4 * 300_000  # float32: at most 300,000 weights, and less than 1.2 MB
    assert b"training.proposer" in data
    assert source_sum().encode() in data  # by the script as it is now


def test_a_seed_is_at_the_place_of_the_full_frame() -> None:
    """Cell (10, 20) of 4 px, 0.25 of a cell right of and 0.5 above its middle, in a picture reduced to a quarter."""
    answer = Answer(10, 20, 0.25, -0.5, 6.0)
    found = proposer.Proposer(answer)(pyramid(np.zeros((480, 640, 3), np.uint8), 1, 8))  # type: ignore[arg-type]
    (seed,) = found
    assert (seed.u_px, seed.v_px, seed.weight) == (331.5, 159.5, 0.75)
    assert seed.radius_px == pytest.approx(24.0, rel=1e-6)
    assert answer.seen is not None
    assert answer.seen.shape == (1, 6, 128, 160)
    assert not answer.seen[0, :, 120:].any()  # 4:3 leaves the lowest rows empty


def test_a_seed_is_the_mean_of_what_the_cells_round_the_peak_say() -> None:
    """At a corner of the grid: 0.6 says (2, 2) px and a radius of 16, its neighbour 0.3 says (5, 0) and 8."""
    maps = np.zeros((4, 32, 40), np.float32)
    maps[:, 0, 0] = 0.6, 0.125, 0.125, math.log(2)
    maps[:, 0, 1] = 0.3, -0.125, -0.375, 0
    (seed,) = proposer.peaks(maps, (128, 160))
    assert (seed.u_px, seed.v_px) == pytest.approx((3.0, 4 / 3), abs=1e-5)
    assert seed.radius_px == pytest.approx(8 * 2 ** (2 / 3), rel=1e-6)
    assert seed.weight == pytest.approx(0.6)


def test_of_neighbouring_cells_only_the_surest_is_a_seed_and_of_many_the_surest_eight() -> None:
    maps = np.zeros((4, 32, 40), np.float32)
    maps[0, 5, 5:7] = 0.5, 0.6
    assert [seed.weight for seed in proposer.peaks(maps, (120, 160))] == [pytest.approx(0.6)]
    maps[0, 1::3, 1::3] = np.linspace(0.2, 0.9, 11 * 13, dtype=np.float32).reshape(11, 13)
    sure = [seed.weight for seed in proposer.peaks(maps, (128, 160))]
    assert len(sure) == proposer.PROPOSED == 8
    assert sure == sorted(sure, reverse=True)


@pytest.mark.parametrize("share", [0.5, 0.8])
def test_a_veil_does_not_change_what_the_net_compares(share: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """But for LEAST_SPREAD, which keeps noise small where there is no contrast."""
    monkeypatch.setattr(proposer, "LEAST_SPREAD", 1e-6)
    picture = decoys.sheet(160, 120, "rust", 3).finished().astype(np.float32)
    plain, dusty = proposer.inputs(picture), proposer.inputs(picture * (1 - share) + 200 * share)
    assert np.abs(plain[:3] - dusty[:3]).max() < 2e-3
    assert np.abs(plain[3] - dusty[3]).max() > 0.3  # the ratio of red to green is not the same


def bay() -> Image:
    """Marker at (401.3, 239.5) px, radius 49.1."""
    scenario = Scenario(seed=8, start=Pose(distance_cm=110, lateral_mm=150))
    return render(scenario, World(scenario).truth(0), 0)


@pytest.mark.parametrize(
    ("image", "seed"),
    [
        (discs.disc(140.3, 90.6, 30.0), Seed(138.6, 90.9, 27.7, 0.762)),
        (veiled(discs.disc(140.3, 90.6, 30.0), 0.9), Seed(138.9, 91.1, 28.0, 0.828)),
        (bay(), Seed(399.5, 240.0, 49.8, 0.668)),
        (veiled(bay(), 0.9), Seed(397.7, 239.0, 51.2, 0.713)),
    ],
    ids=["disc", "disc behind 0.9", "bay", "bay behind 0.9"],
)
def test_the_surest_seed_of_the_shipped_net(image: Image, seed: Seed) -> None:
    found = seeds_of(image)[0]
    assert (found.u_px, found.v_px, found.radius_px) == pytest.approx((seed.u_px, seed.v_px, seed.radius_px), abs=0.5)
    assert found.weight == pytest.approx(seed.weight, abs=0.02)


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((480, 640, 3), np.uint8),
        np.full((480, 640, 3), 255, np.uint8),
        np.full((480, 640, 3), (30, 30, 200), np.uint8),
        np.zeros((1, 1, 3), np.uint8),
        np.full((1, 3000, 3), 255, np.uint8),
        np.full((3000, 2, 3), 80, np.uint8),
        np.full((7, 9, 3), 80, np.uint8),
        np.zeros((3000, 4000, 3), np.uint8),
        np.random.default_rng(1).integers(0, 256, (300, 40, 3), np.uint8),
    ],
    ids=["black", "white", "red", "pixel", "row", "column", "tiny", "huge", "noise"],
)
def test_any_picture_is_answered_and_none_of_these_has_a_marker(image: Image) -> None:
    for seed in seeds_of(image):
        assert all(map(math.isfinite, (seed.u_px, seed.v_px, seed.weight)))
        assert 0 < seed.radius_px < 1e5
    assert detect(image, LEARNED).circle is None


@pytest.mark.one_interpreter
@given(st.integers(8, 90), st.integers(8, 90), st.integers(0, 2**32 - 1))
def test_wild_pictures_give_at_most_eight_finite_seeds(width: int, height: int, seed: int) -> None:
    chance = np.random.default_rng(seed)
    image = np.asarray(chance.integers(0, chance.integers(1, 257), (height, width, 3)), np.uint8)
    found = seeds_of(image)
    assert len(found) <= 8
    for each in found:
        assert -2 * each.radius_px <= each.u_px <= width + 2 * each.radius_px
        assert 0 < each.radius_px < 25 * max(width, height)


def test_the_same_picture_gives_the_same_seeds_whatever_came_between() -> None:
    image = veiled(discs.disc(140.3, 90.6, 30.0), 0.8)
    first = seeds_of(image)
    seeds_of(discs.disc(60.0, 60.0, 12.0))
    assert first
    assert seeds_of(image) == first


def test_a_proposal_is_no_marker_without_evidence(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a plain wall, and on a blue disc, however sure the net is."""
    blue = discs.disc(160.0, 120.0, 40.0, colour=(190, 60, 35))
    for image in (np.full((240, 320, 3), 120, np.uint8), blue):
        monkeypatch.setattr(proposer, "shipped", lambda: lambda levels: [Seed(160.0, 120.0, 40.0, 1.0)])
        assert detect(image, LEARNED).circle is None
        assert detect(image, BOTH).circle is None


def test_only_the_net_is_asked_with_learned_and_its_seed_is_refined(monkeypatch: pytest.MonkeyPatch) -> None:
    image = discs.disc(160.4, 120.2, 40.3)
    monkeypatch.setattr(proposer, "shipped", lambda: lambda levels: [Seed(168.0, 112.0, 46.0, 0.3)])
    found = detect(image, LEARNED)
    assert found.candidates == 1
    circle = discs.circle_of(found)
    assert (circle.u_px, circle.v_px, circle.radius_px) == pytest.approx((160.4, 120.2, 40.3), abs=0.1)
    monkeypatch.setattr(proposer, "shipped", lambda: lambda levels: [])
    assert detect(image, LEARNED).circle is None
    assert detect(image, BOTH) == detect(image, VisionConfig())


def test_the_net_is_not_read_for_classical_proposals(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(proposer, "shipped", lambda: pytest.fail("was read"))
    image = discs.disc(160.4, 120.2, 40.3)
    limits = limits_of(image, VisionConfig(proposals="classical"), None)
    assert search.proposed(search.levels_of(image, limits), limits)
    proposer_file.check(VisionConfig(proposals="classical"))


def test_a_missing_or_damaged_file_is_an_error_that_says_what_to_do(tmp_path: Path) -> None:
    data = proposer_file.PATH.read_bytes()
    with pytest.raises(ConfigError, match=r'none\.onnx, cannot be read: .*vision\.proposals = "classical"'):
        proposer_file.read(tmp_path / "none.onnx")
    flipped = bytes([*data[:5000], data[5000] ^ 1, *data[5001:]])
    for name, wrong in (("cut", data[:-1]), ("flipped", flipped), ("empty", b"")):
        (tmp_path / name).write_bytes(wrong)
        with pytest.raises(ConfigError, match=f'{name}, is damaged; .*vision.proposals = "classical"'):
            proposer_file.read(tmp_path / name)
    with pytest.raises(ConfigError, match="cannot be used"):
        proposer.made(b"no net")


def test_a_gateway_with_a_damaged_net_does_not_start_if_it_needs_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(proposer_file, "SHA256", "another")
    text = '[vision]\nproposals = "both"\n'
    with pytest.raises(ConfigError, match=r"^g\.toml:2: vision\.proposals: the net that proposes, .* is damaged; "):
        config_check.check(parse({"vision": {"proposals": "both"}}, text=text), source="g.toml", text=text)
    config_check.check(parse({"vision": {"proposals": "classical"}}), source="g.toml", text="")


@pytest.mark.parametrize("made", [FullFrameDetector, RoiSearch])
def test_a_detector_reads_the_net_before_its_first_frame(made: type, monkeypatch: pytest.MonkeyPatch) -> None:
    def unusable() -> None:
        raise ConfigError("damaged")

    monkeypatch.setattr(proposer, "shipped", unusable)
    for params in (LEARNED, BOTH):
        with pytest.raises(ConfigError, match="damaged"):
            made(params, lambda: 0)
    made(VisionConfig(proposals="classical"), lambda: 0)


@pytest.mark.long
@pytest.mark.one_interpreter
def test_scenes_are_the_same_for_the_same_seed_and_red_where_the_marker_is() -> None:
    made = list(scenes(3, 40))
    again = list(scenes(3, 40))
    for one, other in zip(made, again, strict=True):
        assert np.array_equal(one.image, other.image)
        assert one.markers == other.markers
    assert {len(scene.markers) for scene in made} == {0, 1, 2}
    red = [
        scene.image[round(v), round(u)].astype(int)
        for scene in made
        for u, v, _ in scene.markers
        if 0 <= u < WIDTH - 1 and 0 <= v < HEIGHT - 1
    ]
    assert np.mean([pixel[2] > 1.5 * pixel[1] for pixel in red]) > 0.8  # something hangs before the others


def test_weather_moves_the_marker_with_the_picture() -> None:
    """A lone dot in a scene is where the sample says it is."""
    chance = np.random.default_rng(4)
    image = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    cv2.circle(image, (100 * 16, 70 * 16), 5 * 16, (255, 255, 255), -1, cv2.LINE_AA, 4)
    for _ in range(20):
        picture, (marker,) = part(Scene(image, ((100.0, 70.0, 5.0),)), chance)
        if not (9 < marker[0] < picture.shape[1] - 9 and 9 < marker[1] < picture.shape[0] - 9):
            continue
        y, x = np.mgrid[0 : picture.shape[0], 0 : picture.shape[1]]
        light = picture[..., 1]
        middle = float((x * light).sum() / light.sum()), float((y * light).sum() / light.sum())
        assert middle == pytest.approx(marker[:2], abs=0.15)
    assert weathered(Scene(image, ()), chance).markers == ()
