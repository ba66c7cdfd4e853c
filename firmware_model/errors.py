"""The one error of this package."""


class FirmwareModelError(ValueError):
    """A plant, an effect or a request that the simulated board refuses; the message names the key and the reason."""
