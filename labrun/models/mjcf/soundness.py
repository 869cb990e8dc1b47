"""Faults of a robot file, named by their link: xacro, links that are not declared, inertias that no body can have."""

import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from labrun.arrays import FloatArray
from labrun.errors import ModelError
from labrun.toml import nearest

_TRIANGLE = 1e-9
"""Part of an inertia by which rounding may break the triangle inequality."""
_LEAST = 1e-6
"""The least principal second moment of a repaired body, as a part of its largest."""


def require_links(path: Path) -> None:
    """Raise ModelError if a file is xacro, or a URDF whose joints name links that it does not declare."""
    try:
        text = path.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise ModelError(f"{path} cannot be read: {error.strerror}") from None
    # what xacro has made keeps the declaration of its name space
    if re.search(r"<xacro:|\$\{[^}]*\}|\$\(arg ", text):
        plain = path.name.removesuffix(".xacro").removesuffix(".urdf").removesuffix(".xml")
        raise ModelError(
            f"{path} is xacro, from which a URDF is made first", hint=f"xacro {path.name} > {plain}.urdf"
        )
    if "<robot" not in text or "<!DOCTYPE" in text or "<!ENTITY" in text:
        return
    try:
        root = ElementTree.fromstring(text)  # noqa: S314 - entities, which can be nested without end, are refused above
    except ElementTree.ParseError:
        return  # MuJoCo says what is wrong, with its line
    links = [link.get("name", "") for link in root.findall("link")]
    for joint in root.findall("joint"):
        for side in ("parent", "child"):
            element = joint.find(side)
            name = element.get("link", "") if element is not None else ""
            if name in links:
                continue
            near = nearest(name, links) if name else None
            what = f"link {name!r}" if name else "no link"
            add = f'did you mean "{near}"? if not, ' if near else ""
            raise ModelError(
                f"{path}: joint {joint.get('name')!r} has {what} as its {side}, which the file does not declare",
                hint=f'{add}add <link name="{name or "base"}"/>',
            )


def check_inertias(spec: Any, path: Path, *, repair: bool) -> list[str]:
    """Return remarks on bodies with impossible inertias, which are replaced by the nearest possible ones.

    The moments of a body are sums of squares: none is more than the other two together, and all are positive.

    Raises ModelError: a mass is negative, or there are such inertias and `repair` is False.
    """
    if spec.compiler.balanceinertia:
        return []
    wrong: list[str] = []
    remarks = []
    for body in spec.bodies[1:]:
        if body.explicitinertial and body.mass < 0.0:
            raise ModelError(
                f"{path}: link {body.name} has a mass of {body.mass:g} kg; a positive number was expected",
                hint="correct its mass in the file: --repair replaces inertias alone",
            )
        if not body.explicitinertial or not np.isfinite(body.mass) or body.mass <= 0.0:
            continue
        full = np.asarray(body.fullinertia, dtype=np.float64)
        whole = bool(np.isfinite(full).all())
        matrix = _matrix(full) if whole else np.diag(np.asarray(body.inertia, dtype=np.float64))
        moments = _moments(matrix) if np.isfinite(matrix).all() and (whole or np.any(matrix)) else None
        if moments is None or (
            moments[0] > 0.0 and moments[2] <= (1.0 + _TRIANGLE) * (moments[0] + moments[1])
        ):
            continue
        line = f"{body.info}, " if body.info else ""
        wrong.append(f"{body.name} ({line}{_listed(moments)} kg m^2)")
        if repair:
            possible = nearest_inertia(matrix)
            if whole:
                body.fullinertia = [*np.diag(possible), possible[0, 1], possible[0, 2], possible[1, 2]]
            else:
                body.inertia = np.diag(possible)
            changed = float(np.linalg.norm(possible - matrix) / np.linalg.norm(matrix))
            remarks.append(
                f"no body can have the inertia of {wrong[-1]}: replaced by the nearest possible one, "
                f"{_listed(_moments(possible))} kg m^2, {changed:.0%} off"
            )
    if wrong and not repair:
        raise ModelError(
            f"{path}: no body can have the inertia of {'; '.join(wrong)}: none of its moments is more than the "
            "other two together, and none is zero or less",
            hint="look at its units and digits; labrun import --repair uses the nearest possible inertia",
        )
    return remarks


def _moments(matrix: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.eigvalsh(matrix), dtype=np.float64)


def nearest_inertia(matrix: FloatArray) -> FloatArray:
    """Return the nearest inertia that a body can have, by the second moments of its mass.

    ``sum of second moments - moments`` must be positive definite (Wensing, Kim, Slotine, IEEE RA-L 3 (2018), 60).
    """
    second = 0.5 * np.trace(matrix) * np.eye(3) - matrix
    values, axes = np.linalg.eigh(second)
    values = np.maximum(values, _LEAST * max(float(values.max()), 1e-12))
    second = (axes * values) @ axes.T
    possible: FloatArray = np.trace(second) * np.eye(3) - second
    return possible


def _matrix(full: FloatArray) -> FloatArray:
    xx, yy, zz, xy, xz, yz = full
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _listed(moments: FloatArray) -> str:
    return ", ".join(f"{moment:.4g}" for moment in moments)
