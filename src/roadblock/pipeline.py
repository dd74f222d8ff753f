"""The flow chart (the paper's figure 1): one pair in, one result out."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from time import perf_counter

from roadblock.config import Settings
from roadblock.detectors import make_detector
from roadblock.errors import SourceError
from roadblock.stages.decide import Decider
from roadblock.stages.egomotion import Odometer
from roadblock.stages.fuse import FreeSpaceMemory
from roadblock.stages.health import judge, looks_swapped
from roadblock.stages.match import stereo_network
from roadblock.stages.recognize import NetworkRecognizer, make_recognizer, weigh_motion
from roadblock.stages.rectify import plan_rectification, rectify
from roadblock.stages.refine import refine
from roadblock.stages.track import Tracker
from roadblock.stages.triangulate import add_calibration_error, locate_all
from roadblock.values.camera import StereoRig
from roadblock.values.frame import RectifiedPair, StereoPair
from roadblock.values.scene import FrameResult


class Pipeline:
    """All stages for one rig. Remembers the drive: frames with time stamps (`StereoPair.t_ns`) are tracked.

    Parameters
    ----------
    rig
        The cameras of the pairs to come.
    settings
        Of all stages.

    Raises
    ------
    RigError
        If the cameras share no view.
    SettingsError
        If the detector is unknown, or the recogniser's network does not fit its description.
    MissingExtraError
        If a network is wanted and the library for it is not installed.
    """

    def __init__(self, rig: StereoRig, settings: Settings | None = None) -> None:
        self.rig = rig
        self.settings = settings or Settings()
        self.rectification = plan_rectification(rig, self.settings.rectify)
        self.detect = make_detector(self.settings)
        self._recognize = make_recognizer(self.settings.recognize, rig.T_vehicle_car)
        self._measure_ego = Odometer(self.rectification, self.settings.egomotion)
        self._remember = FreeSpaceMemory(self.rectification, self.settings.fuse)
        self._tracker = Tracker(self.rectification, rig.T_vehicle_car, self.settings.track)
        self._decider = Decider(self.rectification, rig.T_vehicle_car, self.settings.decide)

    @property
    def network_sha256(self) -> str | None:
        """Hash of the network that names types; None where none does."""
        return self._recognize.session.sha256 if isinstance(self._recognize, NetworkRecognizer) else None

    @property
    def matcher_sha256(self) -> str | None:
        """Hash of the network that matches; None where none does."""
        is_used = self.settings.detector == "dense" and self.settings.match.matcher == "onnx"
        return stereo_network(self.settings.match).session.sha256 if is_used else None

    def step(self, pair: StereoPair) -> tuple[FrameResult, RectifiedPair]:
        """Find every obstacle in one pair.

        Returns
        -------
        The result and the rectified pair its pixels belong to.

        Raises
        ------
        SourceError
            If the images do not fit the rig, or left and right were exchanged.
        """
        timings_ms: dict[str, float] = {}
        with _timed(timings_ms, "rectify"):
            rectified = rectify(pair, self.rectification, self.rig.left.size_px)
        found = self.detect(rectified)
        timings_ms |= found.timings_ms
        with _timed(timings_ms, "refine"):
            # A detector that does not match (one camera, the paper's method) would become another one.
            matches = not math.isnan(found.matched_share)
            regions = refine(rectified, found.regions, self.settings.refine) if matches else found.regions
        with _timed(timings_ms, "triangulate"):
            located = locate_all(
                regions, self.rectification, found.ground, [None] * len(regions), self.rig.T_vehicle_car
            )
            obstacles = add_calibration_error(located, self.rectification, self.rig)
        with _timed(timings_ms, "recognize"):
            obstacles = self._recognize(rectified, found, regions, obstacles)
        health = judge(found, self.settings.health)
        if health.state != "ok" and looks_swapped(rectified):
            raise SourceError(f"frame {pair.name}: the left and right images look swapped: exchange them")
        ego, free_space, decision = None, found.free_space, None
        if self.settings.track.enabled and pair.t_ns != 0:  # single frames have no moment
            with _timed(timings_ms, "egomotion"):
                ego = self._measure_ego(rectified, pair.T_odom_left)
            with _timed(timings_ms, "fuse"):
                free_space = self._remember(free_space, pair.t_ns, ego)
            with _timed(timings_ms, "track"):
                obstacles = self._tracker.update(obstacles, pair.t_ns, ego, found.free_space)
                obstacles = weigh_motion(obstacles, self.settings.recognize.least_probability)
            if self.settings.decide.enabled:
                with _timed(timings_ms, "decide"):
                    decision = self._decider.decide(obstacles, free_space, ego, pair.t_ns, found.ground)
        timings_ms["total"] = sum(timings_ms.values())
        result = FrameResult(
            pair.index,
            pair.name,
            pair.t_ns,
            tuple(sorted(obstacles, key=lambda o: o.range_m)),
            free_space,
            found.ground,
            health,
            timings_ms,
            ego,
            found.stixels,
            decision,
        )
        return result, rectified


@contextmanager
def _timed(timings_ms: dict[str, float], name: str) -> Iterator[None]:
    start = perf_counter()
    yield
    timings_ms[name] = 1e3 * (perf_counter() - start)
