"""Calibration files of sensors that do not exist."""

import numpy as np

AXES = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")
ROWS = np.array(
    [
        [-0.12, 0.03, 1.4, -33.1, -1.5, 32.9],
        [-2.1, 38.7, 0.7, -19.3, 0.4, -19.1],
        [24.2, -0.3, 24.0, 0.2, 24.5, 0.1],
        [-1.1, 51.2, -60.3, -28.9, 61.8, -26.0],
        [69.9, -0.8, -35.5, 46.1, -34.0, -47.3],
        [0.9, -27.1, 1.6, -27.4, 0.3, -27.2],
    ]
)
SCALES = np.array([2.5, 2.5, 1.25, 80.0, 80.0, 75.0])
MAXIMA = np.array([20.0, 20.0, 60.0, 1.0, 1.0, 1.0])


def cal_text(
    *, torque_unit="N-m", force_unit="N", scale=True, axes=AXES, root="FTSensor", extra="", gauges="6"
):
    lines = [
        f'<Axis Name="{name}" values="{" ".join(map(str, ROWS[i]))}" max="{MAXIMA[i]}"'
        + (f' scale="{SCALES[i]}"' if scale else "")
        + "/>"
        for name in axes
        for i in [AXES.index(name)]
    ]
    return (
        f'<?xml version="1.0" encoding="utf-8"?><{root} Serial="FT98765" BodyStyle="Mini40" Family="DAQ" '
        f'NumGages="{gauges}"><Calibration PartNumber="SI-20-1" CalDate="2/3/2001" ForceUnits="{force_unit}" '
        f'TorqueUnits="{torque_unit}" DistUnits="m" OutputMode="Ground Referenced Differential" OutputRange="20" '
        f'HWTempComp="True">{"".join(lines)}{extra}'
        '<BasicTransform Dx="0" Dy="0" Dz="0.006" Rx="0" Ry="0" Rz="0"/></Calibration>'
        f"</{root}>"
    )
