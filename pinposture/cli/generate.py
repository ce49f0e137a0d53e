"""`pinposture generate`: write the URDF of an arm of equal modules."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from pinposture.cli.inputs import ARM, OUTPUT, JsonOption, read_declared, read_numbers
from pinposture.cli.output import examples, print_json, print_note, print_table
from pinposture.errors import InvalidValue
from pinposture.units import length_text


@examples(
    "pinposture generate --list",
    "pinposture generate RyRz --modules 20 -o arm.urdf",
    "pinposture generate RyRz --modules 12 --link-lengths 0.03,0.02 -o long.urdf",
    "pinposture generate RyRz --modules 20 --feed 1.2 -o fed.urdf",
    "pinposture generate Rz --modules 30 | pinposture inspect -",
)
def run(
    *,
    template: Annotated[
        str | None,
        typer.Argument(metavar="TEMPLATE", help="Kind of module: {templates}; --list describes them."),
    ] = None,
    modules: Annotated[int | None, ARM("Number of modules.", "N", flags="--modules -n")] = None,
    link_lengths: Annotated[
        str | None,
        ARM("Length of the link after each joint of a module, in metres. Default: the template's.", "L,..."),
    ] = None,
    feed: Annotated[
        str | None,
        ARM(
            "Stroke of a slide at the base, which feeds the arm along its axis. Default: no slide.", "LENGTH"
        ),
    ] = None,
    output: Annotated[Path | None, OUTPUT("Output file, else stdout.", "FILE", flags="--output -o")] = None,
    as_json: JsonOption = False,
    list_templates: Annotated[bool, typer.Option("--list", help="List the templates and stop.")] = False,
) -> None:
    """Write the URDF of an arm of equal modules.

    It is written to a file, atomically, or to stdout for use in a pipe. With all joints at zero, the arm lies
    along x; its links are "base", "m01_l1", "m01_l2" and so on, and "tip".
    """
    from pinposture.arm import template as template_named
    from pinposture.arm.specification import FeedSpec
    from pinposture.arm.template import modules_to_urdf
    from pinposture.storage import write_text

    if list_templates:
        _list(as_json)
        return
    if template is None:
        raise InvalidValue("TEMPLATE", template, "a kind of module; pinposture generate --list shows them")
    module = template_named(template)
    most = 10_000
    if modules is None or not 1 <= modules <= most:
        raise InvalidValue("--modules", modules, f"a whole number from 1 to {most}")
    if link_lengths is not None:
        module = module.with_lengths(read_numbers("--link-lengths", link_lengths))
    chain = [module] * modules
    if feed is not None:
        chain.insert(0, read_declared(FeedSpec, {"stroke": feed}).before(module))
    text = modules_to_urdf(chain, f"{module.name}_{modules}", "pinposture generate")
    if output is not None:
        write_text(output, text)
    dof = sum(module.dof for module in chain)
    length = sum(module.length for module in chain) - chain[0].lead
    if as_json:
        file = None if output is None else str(output)
        print_json({"file": file, "template": template, "modules": modules, "dof": dof, "length": length})
    elif output is None:
        typer.echo(text, nl=False)
    else:
        print_note(f"wrote {output}: {modules} modules, {dof} DOF, {length_text(length)}")


def _list(as_json: bool) -> None:
    """List the templates."""
    from pinposture.arm import TEMPLATES

    if as_json:
        print_json(
            {"templates": [{**asdict(module), "length": module.length} for module in TEMPLATES.values()]}
        )
        return
    rows = [
        (
            module.name,
            ", ".join(f"{joint.type} {joint.axis}" for joint in module.joints if joint.follows is None)
            + (f" for {len(module.joints)} joints" if module.dof < len(module.joints) else ""),
            ", ".join(f"{length:g}" for length in module.link_lengths[:3])
            + (", ..." if len(module.link_lengths) > 3 else ""),
            module.length,
        )
        for module in TEMPLATES.values()
    ]
    print_table(("template", "joints and axes", "link lengths [m]", "length [m]"), rows)
