"""The paper's method, stage by stage, and the same without looking at every pixel."""
