"""Offscreen pictures and contact sheets, drawn by ray casting without a GL library."""
