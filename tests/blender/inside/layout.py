# SPDX-License-Identifier: Apache-2.0
"""Runs inside Blender: draws panels without a window, into a list of what they would show.

Blender calls a panel's draw only where there is a screen, which the bpy modules do not have. This stands in for
UILayout: names of properties, operators and icons must exist, as Blender itself would insist.
"""

from __future__ import annotations

import types

import bpy

ICONS = frozenset(bpy.types.UILayout.bl_rna.functions["label"].parameters["icon"].enum_items.keys())


class Layout:
    def __init__(self, shown: list[str] | None = None) -> None:
        self.shown = [] if shown is None else shown

    def label(self, text: str = "", icon: str = "NONE") -> None:
        assert icon in ICONS, icon
        self.shown.append(text)

    def prop(self, data: bpy.types.bpy_struct, name: str, text: str | None = None) -> None:
        assert name in data.bl_rna.properties, name
        self.shown.append(data.bl_rna.properties[name].name if text is None else text)

    def operator(self, name: str, text: str | None = None, icon: str = "NONE") -> None:
        assert icon in ICONS, icon
        module, function = name.split(".")
        kind = getattr(getattr(bpy.ops, module), function).get_rna_type()
        self.shown.append(kind.name if text is None else text)

    def column(self, align: bool = False) -> Layout:
        return Layout(self.shown)

    def box(self) -> Layout:
        return Layout(self.shown)


def draw(owner: type, context: object, **attributes: object) -> list[str]:
    """What the draw method of a panel's or operator's class shows."""
    layout = Layout()
    owner.draw(types.SimpleNamespace(layout=layout, **attributes), context)
    return layout.shown
