"""What a person does at the bench of twins, in words: `scuhand-bt twins` reads them, a line each."""

from scuhand_bt.lab import Lab
from scuhand_bt.quantity import MASS, format_mass, parse
from scuhand_bt.run.make_cell import check_weight
from scuhand_bt.sim.wire.bench import WireBench
from scuhand_bt.specs import Container

WORDS = (
    "place KIND ID: a container on the pan",
    "fill SLOT KIND ID: a container into a slot of the changer, from 1",
    "weight 20 g: a check weight on the pan",
    "remove: what stands on the pan",
    "sheet: a fresh sheet in the hand",
)


class Hands:
    """The hands at one bench, whose lab says what kinds of containers there are."""

    def __init__(self, bench: WireBench, lab: Lab) -> None:
        self._bench = bench
        self._kinds = lab.library.containers

    def obey(self, line: str) -> str:
        """Do what a line says; what was done, or why it was not."""
        try:
            return self._do(line.split())
        except (KeyError, ValueError) as error:
            return f"not done: {error.args[0] if error.args else error}"

    def _do(self, words: list[str]) -> str:
        world = self._bench.world
        match words:
            case ["place", kind, name]:
                world.place(self._container(kind, name))
                return f"'{name}' stands on the pan"
            case ["fill", slot, kind, name]:
                self._bench.scene.stands_in(int(slot) - 1, self._container(kind, name))
                return f"'{name}' stands in slot {slot}"
            case ["weight", *mass]:
                mass_mg = parse(" ".join(mass), MASS)
                world.place(check_weight(mass_mg))
                return f"a weight of {format_mass(mass_mg)} stands on the pan"
            case ["remove"]:
                world.remove()
                return "nothing stands on the pan"
            case ["sheet"]:
                world.swap_sheet()
                return "a fresh sheet is in the hand"
        raise ValueError(f"the words are: {'; '.join(WORDS)}")

    def _container(self, kind: str, name: str) -> Container:
        if kind not in self._kinds:
            raise ValueError(f"there is no container '{kind}'; there are: {', '.join(sorted(self._kinds))}")
        return Container.model_validate({**self._kinds[kind].model_dump(), "id": name})
