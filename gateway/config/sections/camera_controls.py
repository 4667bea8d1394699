"""`[camera.controls]`: what a V4L2 camera is set to, by the driver's names and in its units (`v4l2-ctl -L`). Pure."""

from typing import Literal, Self

from pydantic import Field, model_validator

from gateway.config.strict.errors import FieldError
from gateway.config.strict.section import Section

INT32 = 2**31 - 1

AutoExposure = Literal["auto", "manual", "shutter_priority", "aperture_priority"]
PowerLine = Literal["disabled", "50hz", "60hz", "auto"]


class ControlsConfig(Section):
    """A key that is absent leaves the control as it is. Ranges are the camera's own: they are checked when it opens."""

    auto_exposure: AutoExposure | None = Field(
        None,
        description='"auto", "manual", "shutter_priority" or "aperture_priority", as far as the camera has it; '
        "exposure_time_absolute implies manual",
    )
    exposure_dynamic_framerate: bool | None = Field(
        None, description="automatic exposure may lower the frame rate; formerly exposure_auto_priority"
    )
    exposure_time_absolute: int | None = Field(None, ge=1, le=INT32, description="exposure time, in 100 us: 50 is 5 ms")
    gain_automatic: bool | None = Field(None, description="the camera sets its gain; gain implies false")
    gain: int | None = Field(None, ge=-INT32, le=INT32, description="in the driver's units")
    white_balance_automatic: bool | None = Field(
        None, description="the camera follows the colour of the light; white_balance_temperature implies false"
    )
    white_balance_temperature: int | None = Field(None, ge=0, le=INT32, description="colour of the light, kelvin")
    focus_automatic_continuous: bool | None = Field(
        None, description="the camera focuses by itself; focus_absolute implies false"
    )
    focus_absolute: int | None = Field(None, ge=-INT32, le=INT32, description="in the driver's units")
    zoom_absolute: int | None = Field(None, ge=-INT32, le=INT32, description="in the driver's units")
    power_line_frequency: PowerLine | None = Field(
        None, description='against the flicker of lamps: "disabled", "50hz", "60hz" or "auto"'
    )
    brightness: int | None = Field(None, ge=-INT32, le=INT32, description="in the driver's units")
    contrast: int | None = Field(None, ge=-INT32, le=INT32, description="in the driver's units")
    saturation: int | None = Field(None, ge=-INT32, le=INT32, description="in the driver's units")
    gamma: int | None = Field(None, ge=-INT32, le=INT32, description="in the driver's units")
    sharpness: int | None = Field(
        None, ge=-INT32, le=INT32, description="in the driver's units; the least one is best: sharpening moves edges"
    )
    backlight_compensation: int | None = Field(None, ge=-INT32, le=INT32, description="in the driver's units")

    @model_validator(mode="after")
    def _one_hand(self) -> Self:
        for automatic, key in AUTOMATIC.items():
            if getattr(self, automatic) in (True, "auto", "aperture_priority") and getattr(self, key) is not None:
                shown = "true" if getattr(self, automatic) is True else f'"{getattr(self, automatic)}"'
                raise FieldError(f"has no effect with camera.controls.{automatic} = {shown}", key)
        return self


AUTOMATIC = {
    "auto_exposure": "exposure_time_absolute",
    "gain_automatic": "gain",
    "white_balance_automatic": "white_balance_temperature",
    "focus_automatic_continuous": "focus_absolute",
}
"""Key of an automatic, and the key of what it sets."""
