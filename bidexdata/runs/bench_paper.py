"""The paper's own figures of the tables that `bench tables` makes again; shares and metres.

Source: BiDexGrasp, table 2 (comparison), table 3 (ablation of data synthesis), appendix (region
selection). Their objects are 1000 of DexGraspNet and of Objaverse, at six sizes from 30 to 80 cm;
speeds are those of one RTX 3090, BimanGrasp's as it was published.
"""

from __future__ import annotations

from typing import Any

DATASETS = {"dexgraspnet": "DexGraspNet", "objaverse": "Objaverse"}
"""What the paper's objects are from, by key."""


def _figures(**columns: float | None) -> dict[str, float | None]:
    """Percent to shares, centimetres to metres; speeds and D stay."""
    unit = {"suc_f": 1e-2, "suc_l": 1e-2, "suc_a": 1e-2, "pd": 1e-2, "spd": 1e-2, "cdc": 1e-2}
    return {
        name: None if value is None else round(value * unit.get(name, 1.0), 6)
        for name, value in columns.items()
    }


def _table_2(
    f: float,
    l: float | None,
    a: float | None,
    s: float,
    pd: float,
    spd: float,
    cdc: float,
    d: float,
) -> dict[str, float | None]:
    return _figures(suc_f=f, suc_l=l, suc_a=a, s=s, pd=pd, spd=spd, cdc=cdc, d=d)


def _table_3(l: float, a: float, sgs: float, pd: float, spd: float) -> dict[str, float | None]:
    return _figures(suc_l=l, suc_a=a, sgs=sgs, pd=pd, spd=spd)


PAPER: dict[str, Any] = {
    "table_2": {
        "bimangrasp": {
            "dexgraspnet": _table_2(26.80, None, None, 0.16, 1.52, 0.26, 1.87, 0.150),
            "objaverse": _table_2(30.21, None, None, 0.16, 0.87, 0.23, 1.38, 0.156),
        },
        "ours_floating": {
            "dexgraspnet": _table_2(75.84, None, None, 6.73, 0.17, 0.02, 0.59, 0.190),
            "objaverse": _table_2(70.82, None, None, 4.55, 0.20, 0.04, 0.67, 0.180),
        },
        "ours_tabletop": {
            "dexgraspnet": _table_2(77.11, 80.83, 71.34, 6.87, 0.15, 0.02, 0.52, 0.165),
            "objaverse": _table_2(62.41, 70.41, 62.40, 5.10, 0.20, 0.05, 0.67, 0.158),
        },
    },
    "table_3": {
        "bodex": _table_3(28.3, 12.9, 2.1, 0.18, 0.08),
        "paper_r": _table_3(44.4, 39.8, 2.8, 0.13, 0.03),
        "paper_r_dc": _table_3(57.7, 49.5, 4.0, 0.15, 0.03),
        "paper_r_dc_ps": _table_3(80.8, 71.3, 5.6, 0.15, 0.03),
    },
    "regions": {
        "paper_random": {"dexgraspnet": 0.0047, "objaverse": 0.0079},
        "paper": {"dexgraspnet": 0.0125, "objaverse": 0.0141},
    },
}
"""By table, row (or kind of regions) and data set; table 3 names none."""
