from handover_robots.scene.vision import Camera
from handover_robots.settings import TrajectorySettings

PARTS = ["part-1", "part-2"]


def test_by_default_the_first_scan_misses_and_the_second_finds() -> None:
    settings = TrajectorySettings.load()
    camera = Camera(settings.detection_rate, settings.scan_seed)
    assert camera.look(PARTS) is None
    assert camera.look(PARTS) == "part-1"


def test_the_same_seed_gives_the_same_scans() -> None:
    first, second = Camera(0.5, 3), Camera(0.5, 3)
    scans = [first.look(PARTS) for _ in range(50)]
    assert scans == [second.look(PARTS) for _ in range(50)]
    assert {None, "part-1"} == set(scans)


def test_parts_are_detected_at_the_detection_rate() -> None:
    camera = Camera(0.7, 1)
    seen = sum(camera.look(PARTS) is not None for _ in range(10_000))
    assert 6_800 < seen < 7_200


def test_nothing_is_seen_in_an_empty_bin() -> None:
    assert Camera(1.0, 0).look([]) is None
