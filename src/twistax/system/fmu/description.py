"""The XML files of a functional mock-up unit: its variables, and its compilation. FMI 3.0.1, chapters 2.4, 2.5."""

from __future__ import annotations

from xml.etree import ElementTree

from ...expr.kinds.unit import Unit
from ...scalar.kernel_cache import version
from .variables import UnitVariable, VariableList, base_exponents


def model_description(name: str, token: str, variables: VariableList, step: float | None) -> str:
    """The text of `modelDescription.xml`.

    Args:
        name: the name of the model and of its files.
        token: the token that is checked when the unit is instantiated.
        step: the length of an internal step of co-simulation; None for model exchange only.
    """
    root = ElementTree.Element(
        "fmiModelDescription",
        fmiVersion="3.0",
        modelName=name,
        instantiationToken=token,
        generationTool=f"twistax {version()}",
        variableNamingConvention="flat",
    )
    state = {"canGetAndSetFMUState": "true", "canSerializeFMUState": "true"}
    exchange = {**state, "providesDirectionalDerivatives": "true", "needsCompletedIntegratorStep": "false"}
    ElementTree.SubElement(root, "ModelExchange", {"modelIdentifier": name, **exchange})
    if step is not None:
        steps = {**state, "canHandleVariableCommunicationStepSize": "true", "fixedInternalStepSize": repr(step)}
        ElementTree.SubElement(root, "CoSimulation", {"modelIdentifier": name, **steps})
    units = {str(v.unit): v.unit for v in variables.all if base_exponents(v.unit) is not None and v.unit is not None}
    _add_units(root, units)
    if step is not None:
        ElementTree.SubElement(root, "DefaultExperiment", startTime="0.0", stepSize=repr(step))
    entries = ElementTree.SubElement(root, "ModelVariables")
    for variable in variables.all:
        ElementTree.SubElement(entries, "Float64", _attributes(variable, units))
    structure = ElementTree.SubElement(root, "ModelStructure")
    outputs = [v for v in variables.all if v.causality == "output"]
    derivatives = [v for v in variables.all if v.derivative is not None]
    unknown = [v for v in outputs if v.start is None] + derivatives
    for tag, of_tag in (("Output", outputs), ("ContinuousStateDerivative", derivatives), ("InitialUnknown", unknown)):
        for variable in of_tag:
            ElementTree.SubElement(structure, tag, valueReference=str(variable.reference))
    return _text(root)


def build_description(name: str) -> str:
    """The text of `sources/buildDescription.xml`."""
    root = ElementTree.Element("fmiBuildDescription", fmiVersion="3.0")
    build = ElementTree.SubElement(root, "BuildConfiguration", modelIdentifier=name)
    files = ElementTree.SubElement(build, "SourceFileSet", language="C99")
    ElementTree.SubElement(files, "SourceFile", name=f"{name}.c")
    ElementTree.SubElement(build, "Library", name="m", external="true")
    return _text(root)


def _add_units(root: ElementTree.Element, units: dict[str, Unit]) -> None:
    if not units:
        return
    definitions = ElementTree.SubElement(root, "UnitDefinitions")
    for name, unit in units.items():
        powers = base_exponents(unit) or {}
        of_unit = ElementTree.SubElement(definitions, "Unit", name=name)
        ElementTree.SubElement(of_unit, "BaseUnit", {base: str(power) for base, power in powers.items()})


def _attributes(variable: UnitVariable, units: dict[str, Unit]) -> dict[str, str]:
    attributes = {
        "name": variable.name,
        "valueReference": str(variable.reference),
        "causality": variable.causality,
        "variability": variable.variability,
    }
    if variable.causality == "output" or variable.derivative is not None:
        attributes["initial"] = "calculated" if variable.start is None else "exact"
    if str(variable.unit) in units:
        attributes["unit"] = str(variable.unit)
    if variable.derivative is not None:
        attributes["derivative"] = str(variable.derivative)
    attributes |= {side: repr(limit) for side, limit in zip(("min", "max"), variable.limits) if limit is not None}
    if variable.start is not None:
        attributes["start"] = repr(variable.start)
    return attributes


def _text(root: ElementTree.Element) -> str:
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"
