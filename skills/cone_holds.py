"""Check that the cone holds enough of the right powder."""

from scuhand_bt.dosing.strokes import LAST_SHARE
from scuhand_bt.skill import Cell, Code, Condition, Milligrams, Powder, SkillFailed


class ConeHolds(Condition):
    """Hold if the cone is believed to contain enough of this powder, and to let it out."""

    raises = (Code.HAND_CONE_EMPTY, Code.HAND_WRONG_POWDER)
    watches = ("hand",)

    powder: Powder
    lot: str | None = None
    """The lot that it must be of: "" for a source that names none, None for any."""
    at_least_mg: Milligrams = 1.0
    wanted_mg: Milligrams = 0.0
    """The mass to be dosed from it. The last third of the load is not counted, as it flows badly.

    A dose too large for one load only needs more than that third. A load whose yield is to be learnt is used to its end
    (docs/scoop-belief.md, Which loads are used up)."""

    def check(self, cell: Cell) -> None:
        believed = cell.believed
        source = cell.sources.get(believed.cone_source or "")
        enough_mg = self.at_least_mg
        if self.wanted_mg > 0.0 and source is not None:
            load = believed.load
            last_mg = LAST_SHARE * (believed.cone_mg + max(0.0, load.came_mg)) if load.scooped_mg > 0.0 else 0.0
            is_one_load = self.wanted_mg + last_mg <= source.powder.load_limit_mg
            enough_mg = max(enough_mg, last_mg + (self.wanted_mg if is_one_load else 0.0))
            if load.may_be_used_up(self.wanted_mg, believed.cone_mg, believed.seen_yields.get(source.name)):
                enough_mg = 0.0  # the load may be larger than believed, and is used up to learn that
            if load.scooped_mg > 0.0 and load.came_mg == 0.0:
                enough_mg = self.at_least_mg  # untouched: another scoop would bring no more
        if source is None or believed.cone_mg < enough_mg:
            raise SkillFailed(Code.HAND_CONE_EMPTY, f"the cone is believed to hold {believed.cone_mg:.0f} mg")
        if believed.is_load_doubted:
            raise SkillFailed(Code.HAND_CONE_EMPTY, "the cone's load was not as expected: it is let out first")
        if believed.load.is_rest:
            raise SkillFailed(
                Code.HAND_CONE_EMPTY, "the rest in the cone flows only when it is shaken: it is put away first"
            )
        if source.powder.name != self.powder.name:
            raise SkillFailed(Code.HAND_WRONG_POWDER, f"the cone holds {source.powder.name}, not {self.powder.name}")
        if self.lot not in (None, source.lot):
            wanted = f"lot '{self.lot}'" if self.lot else "powder of a source without a lot"
            raise SkillFailed(Code.HAND_WRONG_POWDER, f"the cone holds {source.sheet_key}, not {wanted}")
