"""`driver: "scuhand_xarm7:DRIVER"` of an arm: the name that the example's cell needs, and no driver yet."""

from pydantic import BaseModel, ConfigDict

from scuhand_bt.devices.interfaces import Site
from scuhand_bt.failures import Code, SkillFailed


class Options(BaseModel):
    """None."""

    model_config = ConfigDict(extra="forbid")


class XArm7:
    """Known to `check` and to dry runs; a run on a real cell is refused before anything moves."""

    Options = Options
    twin = ""

    def connect(self, site: Site, /) -> None:
        """SkillFailed device.lost: always."""
        raise SkillFailed(Code.DEVICE_LOST, "nobody has written a driver of the xArm7 yet: this cell runs dry only")


DRIVER = XArm7()
