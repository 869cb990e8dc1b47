"""A ranking as a person reads it: gaits by water, whether the order carries over, which gait to take, and why."""

from collections.abc import Sequence
from pathlib import Path

from labrun.report.text import aligned
from labrun.search import NUMBER, Agreement, Ranking
from labrun.spec import condition_text


def ranking_text(ranking: Ranking) -> str:
    """Return the table of gaits by water, the agreements, and which gait to take, and why."""
    heads = [condition_text(column.setting) or ranking.objective for column in ranking.columns]
    labs = [Path(path).parent.name for path in ranking.laboratories]
    rows = [["gait", *labs, *heads]]
    for place, gait in enumerate(ranking.gaits):
        row = [f"{gait.get(NUMBER, place + 1):g}"]
        for path in ranking.laboratories:
            value = ranking.laboratory_values[path][place]
            row.append("-" if value is None else f"{value:.4g}")
        for column in ranking.columns:
            cell = column.cells[place]
            text = "-" if cell is None else f"{cell.mean:.4g}"
            if cell is not None and cell.ci95 is not None:
                text += f" ({cell.ci95[0]:.4g} to {cell.ci95[1]:.4g})"
            row.append(text)
        rows.append(row)
    lines = [f"{f'{ranking.objective} {ranking.unit}'.strip()}, mean with 95 % interval; laboratory: mean"]
    lines += [*aligned(rows), ""]
    for path, lab in zip(ranking.laboratories, labs, strict=True):
        for column, head in zip(ranking.columns, heads, strict=True):
            lines += _agreement_lines(column.agreements[path], lab, head)
    lines += [f"note      {note}" for note in ranking.notes]
    lines += _winner_lines(ranking, heads)
    return "\n".join(lines)


def _agreement_lines(found: Agreement | None, lab: str, head: str) -> list[str]:
    what = f"{lab} and {head}"
    if found is None:
        return [f"{what}: no order to compare: fewer than three gaits in common, or all alike"]
    p = "exact p" if found.exact else "p of sampled orders"
    ties = f", {found.ties} tied pairs" if found.ties else ""
    tau, rho = found.tau_ci95, found.spearman_ci95
    lines = [
        f"{what}, {found.count} gaits{ties}:",
        f"  Kendall tau {found.tau:.2f} ({tau[0]:.2f} to {tau[1]:.2f}), {p} = {found.tau_p:.3g}; "
        f"Spearman rho {found.spearman:.2f} ({rho[0]:.2f} to {rho[1]:.2f}), {p} = {found.spearman_p:.3g}",
    ]
    if not found.carries_over:
        lines.append(f"  the laboratory's order does not carry over to {head}: the interval of tau covers 0")
    return lines


def _winner_lines(ranking: Ranking, heads: Sequence[str]) -> list[str]:
    if ranking.winner is None:
        return []
    place = ranking.winner
    bounds = [
        (ranking.bound(column, place), head) for column, head in zip(ranking.columns, heads, strict=True)
    ]
    sign = 1.0 if ranking.maximise else -1.0
    bound, head = min(((b, h) for b, h in bounds if b is not None), key=lambda item: sign * item[0])
    end, beyond = ("from", "greatest") if ranking.maximise else ("up to", "least")
    why = f"in its worst water ({head}) its interval goes {end} {bound:.4g} {ranking.unit}, the {beyond} of all gaits"
    return [
        f"take {ranking.name(place)}: {why}",
        f"          {condition_text(ranking.gaits[place], digits=4)}",
    ]
