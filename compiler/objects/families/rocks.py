"""Declares classes of procedural rocks, and draws their shapes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, ClassVar

from scenec.compiler.distributions.numbers import Number
from scenec.compiler.kinds import Context, Finding, Form, Node, an, draw_object, forms, key, list_of
from scenec.compiler.kinds.declare import keys_of
from scenec.compiler.kinds.draw import values_of
from scenec.compiler.kinds.table import ROCKS, loaded, offered_kind
from scenec.compiler.objects.families.shape import Shape
from scenec.compiler.objects.scattered import Scattered
from scenec.schemas.codec import JsonObject
from scenec.schemas.spelling import shown

if TYPE_CHECKING:
    from scenec.compiler.objects.feet import Fillet
    from scenec.compiler.objects.plan import ScatterPlan


def family_of(name: str) -> type[Any]:
    """Returns the class of a family; another package's where it is no own one.

    Raises:
        ScenecError: No package offers it, or what it offers is no kind.
    """
    if name not in ROCKS:
        return offered_kind("scenec.rocks", name)
    family: type[Any] = loaded(f"objects.families.{name}:{name.capitalize()}Rock")
    return family


@dataclass(frozen=True, kw_only=True)
class Rocks(Scattered):
    """Procedural rocks scattered over the terrain."""

    EXAMPLE: ClassVar = {
        "type": "rocks",
        "count": 2000,
        "material": "basalt",
        "labels": {"class": "rock"},
        "family": "angular",
        "size_m": {"type": "log_uniform", "min": 0.05, "max": 0.8},
    }

    KEYWORDS: ClassVar = {"x-kinds": "family"}

    material: str = key(forms.TEXT)
    """Name of a material."""
    family: str = key(Form({"x-open": "scenec.rocks", "enum": list(ROCKS)}), default="weathered")
    """Kind of rock; docs/objects.md shows them. Slabs lie flat, ventifacts and bedded blocks stand
    upright, unless orientation says otherwise. Ventifacts face the wind of the relief's dunes,
    barchans or ripples, or else a drawn one."""
    prototypes: int = key(forms.WHOLE_PER_BATCH, default=6, at_least=1, at_most=64)
    """Number of different shapes."""
    subdivisions: int = key(forms.WHOLE_PER_BATCH, default=3, at_least=1, at_most=6)
    """Subdivisions of a shape's icosahedron: 20 * 4^n triangles at the finest level."""
    size_m: Number = key(forms.LENGTH_PER_INSTANCE, above=0, at_most=1_000_000)
    """Diameter of a rock."""
    elongation: float | None = key(forms.PER_BATCH, optional=True, at_least=0, at_most=0.9)
    """How much narrower than long, 1 - b/a, on average. Left out, by family: weathered 0.18,
    angular 0.29, rounded 0.22, slab 0.25, vesicular 0.2, ventifact 0.28, bedded 0.25, breccia
    0.22."""
    flatness: float | None = key(forms.PER_BATCH, optional=True, at_least=0, at_most=0.9)
    """How much lower than long, 1 - c/a, on average. Left out, by family: weathered 0.4, angular
    0.5, rounded 0.45, slab 0.8, vesicular 0.35, ventifact 0.5, bedded 0.45, breccia 0.4."""
    angularity: float = key(forms.FRACTION_PER_BATCH, default=0.6)
    """From rounded (0) to broken along flat faces (1); of the family weathered only."""
    wear: float | None = key(forms.FRACTION_PER_BATCH, optional=True)
    """How worn edges are, 0 freshly broken; not of weathered. Left out, by family: angular 0.1,
    rounded 0.7, slab 0.15, vesicular 0.4, ventifact 0.12, bedded 0.35, breccia 0.4."""
    bumpiness: float = key(forms.FRACTION_PER_BATCH, default=0.3)
    """Height of the small relief on a rock; 0 is smooth."""
    coatings: tuple[JsonObject, ...] = key(
        list_of(an("objects_rocks_coating"), "One coating.", most=8), default=[]
    )
    """What lies on the rocks, the lowest first: dust, snow, moss, a wet foot. Not on rocks turned
    at random, which share no top."""
    fillet: Fillet | None = key(an("objects_rocks_fillet", drawn=True), optional=True)
    """Fines heaped about the feet of the rocks; left out, there are none."""
    added: JsonObject = field(default_factory=dict)
    """Keys that another package's family has."""

    @staticmethod
    def check(node: Node, hint: str | None = "") -> Iterator[Finding]:
        """Yields findings between its keys, as of ``Scattered``, and with its family's."""
        family = family_of(node["family"]) if node["family"] in ROCKS else None
        if family:
            (other,) = {"wear", "angularity"} - {family.READS}
            if other in node:
                yield node.key_fault(
                    f"rocks of the family {shown(node['family'])} have no {other}: expected "
                    f"{family.READS}",
                    other,
                )
        turned = node["orientation"] or ("normal" if family and family.LIES else "random")
        if turned == "random":
            lacks = {"coatings": "top that a coating could lie on", "lean_deg": "axis that leans"}
            for own, what in lacks.items():
                if own in node:
                    yield node.key_fault(
                        f"what is turned at random has no {what}: expected the orientation "
                        '"upright" or "normal"',
                        own,
                    )
        size = node.entries.get("size_m")
        law = size if isinstance(size, dict) else {}
        tells = law.get("type") == "golombek_rapp" and law.get("per", "instance") == "instance"
        hint = ', or a size_m of the type "golombek_rapp", which says how many there are'
        yield from Scattered.check(node, None if tells else hint)

    def draw(self, context: Context) -> ScatterPlan:
        """Returns what is drawn of the class.

        Raises:
            SceneError: There would be too many rocks.
        """
        # Imported here: cfgs are checked without.
        from scenec.compiler.objects.drawing import draw_scattered
        from scenec.compiler.objects.plan import RockShapes

        path, family = context.path, family_of(self.family)
        shapes = tuple(
            self._shape(family, f"{path}/prototypes/{i}", context)
            for i in range(int(self.prototypes))
        )
        coatings = tuple(
            draw_object("objects_rocks_coating", own, f"{path}/coatings/{i}", context)
            for i, own in enumerate(self.coatings)
        )
        plan = draw_scattered(
            self,
            context,
            material=self.material,
            source=RockShapes(shapes, coatings),
            weights=[1.0] * len(shapes),
            orientation="normal" if family.LIES else "random",
            size_key="size_m",
            turn=family.turn(shapes, context),
        )
        if self.fillet is None:
            return plan
        fillet = self.fillet.draw(context.at(f"{path}/fillet"), len(plan.scale))
        return replace(plan, fillet=fillet)

    def _shape(self, family: type[Any], path: str, context: Context) -> Shape:
        streams = context.streams
        given = self.elongation, self.flatness, self.wear
        elongation, flatness, wear = (
            usual if said is None else said for said, usual in zip(given, family.USUAL, strict=True)
        )
        if family.READS == "angularity":
            wear = 1.0 - self.angularity
        # Axes b <= a by elongation, c <= b by flatness: their means are as asked.
        u = streams.uniforms(f"{path}/axes", 2)
        middle = 1.0 - min(elongation * (0.4 + 1.2 * u[0]), 0.95)
        low = 1.0 - flatness * (0.75 + 0.5 * u[1])
        if self.family in ROCKS:
            own = {"drawn": family.draw(path, streams, wear)}
        else:
            own = self._of_package(family, context)
        shape: Shape = family(
            key=streams.key(path),
            bumpiness=self.bumpiness,
            axes=(1.0, middle, min(max(low, 0.05), middle)),
            subdivisions=int(self.subdivisions),
            **own,
        )
        return shape

    def _of_package(self, family: type[Any], context: Context) -> dict[str, Any]:
        """Returns keys of another package's family; rocks can have some of them themselves."""
        declared = not hasattr(family, "SCHEMA")
        names = keys_of(family) if declared else family.SCHEMA.get("properties", {})
        own = {name: self.added.get(name, getattr(self, name, None)) for name in names}
        return values_of(family, own, context.path, context) if declared else own
