"""A dome camera before an object, both simulated, with frames that fail to arrive."""

from collections.abc import Container
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ._bench import SimulatedBench
from ._contract import SensorError


class SimulatedSensor:
    """The dome camera of a `SimulatedBench`, as a `TouchSensor`.

    Parameters
    ----------
    bench : SimulatedBench
        Where the dome is and what it touches.
    random_state : int, default=0
        Seed of the noise of the frames.
    missing : container of int, default=()
        Numbers of the frames, counted from 0, that do not arrive.
    """

    geometry = "dome"

    def __init__(
        self,
        bench: SimulatedBench,
        *,
        random_state: int = 0,
        missing: Container[int] = (),
    ) -> None:
        self._bench = bench
        self._rng = np.random.default_rng(random_state)
        self._missing = missing
        self.n_asked = 0

    @property
    def image_shape(self) -> tuple[int, int]:
        """(n_rows, n_cols) of every frame."""
        return self._bench.camera.image_shape

    def read(self) -> NDArray[Any]:
        """Return the frame of this moment, or raise `SensorError`."""
        number, self.n_asked = self.n_asked, self.n_asked + 1
        if number in self._missing:
            raise SensorError(f"Frame {number} did not arrive.")
        return self._bench.frame(self._rng)

    def no_contact(self) -> NDArray[Any]:
        """Return the frame of touching nothing, without noise."""
        return self._bench.camera.no_contact()
