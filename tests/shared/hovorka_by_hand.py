"""The models of Hovorka (2004) and Wilinska (2010) written out by hand, and people to try them on."""

import numpy as np

from glucoloop.patients.hovorka import (
    STATE_NAMES,
    HovorkaParameters,
    WilinskaParameters,
    at_setpoint,
    wilinska,
)
from glucoloop.patients.hovorka.hovorka2004 import CONSTANTS

NOMINAL = {constant.name: constant.value for constant in CONSTANTS}
ANOTHER = NOMINAL | {
    "weight_kg": 91.0,
    "t_maxI": 48.0,
    "k_e": 0.155,
    "V_I": 0.131,
    "k_a1": 0.0081,
    "k_a2": 0.041,
    "k_a3": 0.044,
    "S_IT": 38.0e-4,
    "S_ID": 11.5e-4,
    "S_IE": 410e-4,
    "V_G": 0.138,
    "k_12": 0.051,
    "EGP_0": 0.0183,
    "F_01": 0.0088,
    "t_IG": 9.0,
    "A_G": 0.95,
    "t_maxG": 52.0,
}
WILINSKA = {constant.name: constant.value for constant in wilinska.CONSTANTS}
OTHER_WILINSKA = WILINSKA | {
    "weight_kg": 61.0,
    "t_maxI": 48.0,
    "k_e": 0.155,
    "V_I": 0.131,
    "k_a1": 0.0051,
    "k_a2": 0.041,
    "k_a3": 0.031,
    "S_IT": 26.0e-4,
    "S_ID": 3.5e-4,
    "S_IE": 270e-4,
    "V_G": 0.138,
    "k_12": 0.051,
    "EGP_0": 0.0183,
    "F_01": 0.0098,
    "renal_threshold": 10.5,
    "renal_clearance": 0.02,
    "t_IG": 7.0,
    "A_G": 0.95,
    "t_maxG": 52.0,
}
EVERYBODY = [NOMINAL, ANOTHER, WILINSKA, OTHER_WILINSKA]


def parameters(constants):
    return (WilinskaParameters if "uptake_half" in constants else HovorkaParameters)(**constants)


def wilinska_by_hand(p, x, u, appearing_mg_min):
    """Right-hand side as the simulator of the McGill Diabetes Lab has it, per kg of weight and in umol, U and hours."""
    S1, S2, I, x1, x2, x3, Q1, Q2, IG = x
    w, ka, Vg, Vi = p["weight_kg"], 1.0 / p["t_maxI"], 1000.0 * p["V_G"], 1000.0 * p["V_I"]
    s1, s2, q1, q2 = S1 / 1000.0, S2 / 1000.0, 1000.0 * Q1 / w, 1000.0 * Q2 / w
    Um = 1000.0 * appearing_mg_min / 180.16 / w
    above = q1 > p["renal_threshold"] * Vg
    dq1 = -(1000.0 * p["F_01"] / 0.85 / (q1 + Vg) + x1) * q1 + p["k_12"] * q2 + Um
    dq1 += 1000.0 * p["EGP_0"] * np.exp(-x3) - p["renal_clearance"] * (q1 - p["renal_threshold"] * Vg) * above
    dq2 = x1 * q1 - (p["k_12"] + x2) * q2
    return np.array(
        [
            1000.0 * (u * 60.0 / 1000.0 / 60.0 - ka * s1),
            1000.0 * ka * (s1 - s2),
            1e6 * ka * s2 / (Vi * w) - p["k_e"] * I,
            -p["k_a1"] * x1 + p["k_a1"] * p["S_IT"] * I,
            -p["k_a2"] * x2 + p["k_a2"] * p["S_ID"] * I,
            -p["k_a3"] * x3 + p["k_a3"] * p["S_IE"] * I,
            dq1 * w / 1000.0,
            dq2 * w / 1000.0,
            (q1 / Vg - IG) / p["t_IG"],
        ]
    )


def by_hand(p, x, u, appearing_mg_min):
    return (wilinska_by_hand if "uptake_half" in p else hovorka_by_hand)(p, x, u, appearing_mg_min)


def hovorka_by_hand(p, x, u, appearing_mg_min):
    """Right-hand side as the paper prints it, one scalar at a time: S1, S2, I, x1, x2, x3, Q1, Q2, IG."""
    S1, S2, I, x1, x2, x3, Q1, Q2, IG = x
    BW = p["weight_kg"]
    V_I, V_G = p["V_I"] * BW, p["V_G"] * BW
    k_b1, k_b2, k_b3 = p["S_IT"] * p["k_a1"], p["S_ID"] * p["k_a2"], p["S_IE"] * p["k_a3"]
    G = Q1 / V_G
    F_01c = p["F_01"] * BW if G >= 4.5 else p["F_01"] * BW * G / 4.5
    F_R = 0.003 * (G - 9.0) * V_G if G >= 9.0 else 0.0
    EGP = p["EGP_0"] * BW * (1.0 - x3) if x3 < 1.0 else 0.0
    U_G = appearing_mg_min / 180.16
    return np.array(
        [
            u - S1 / p["t_maxI"],
            S1 / p["t_maxI"] - S2 / p["t_maxI"],
            S2 / p["t_maxI"] / V_I - p["k_e"] * I,
            -p["k_a1"] * x1 + k_b1 * I,
            -p["k_a2"] * x2 + k_b2 * I,
            -p["k_a3"] * x3 + k_b3 * I,
            -F_01c - x1 * Q1 + p["k_12"] * Q2 - F_R + U_G + EGP,
            x1 * Q1 - (p["k_12"] + x2) * Q2,
            (G - IG) / p["t_IG"],
        ]
    )


BY_HAND_NAMES = ("S1", "S2", "I", "x1", "x2", "x3", "Q1", "Q2", "IG")
TO_OURS = [BY_HAND_NAMES.index(name) for name in STATE_NAMES]
TO_HAND = [STATE_NAMES.index(name) for name in BY_HAND_NAMES]


def person(constants, setpoint=120.0):
    return at_setpoint(parameters(constants), setpoint)
