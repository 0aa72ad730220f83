"""What exploration needs of a tactile sensor: one frame, now."""

from typing import Any, Protocol, runtime_checkable

from numpy.typing import NDArray


class SensorError(RuntimeError):
    """A frame that did not arrive, or is no frame."""


@runtime_checkable
class TouchSensor(Protocol):
    """A tactile sensor that can be asked for a frame.

    Attributes
    ----------
    image_shape : tuple of int
        (n_rows, n_cols) of every frame.
    geometry : str or None
        How its taxels lie, see `Touches`.
    """

    @property
    def image_shape(self) -> tuple[int, int]: ...

    @property
    def geometry(self) -> str | None: ...

    def read(self) -> NDArray[Any]:
        """Return a frame taken after this call, shape `image_shape`.

        Raises
        ------
        SensorError
            None arrived in the sensor's own time limit.
        """
        ...

    def no_contact(self) -> NDArray[Any] | None:
        """Return the frame of touching nothing, or None where it is not known."""
        ...
