"""Recurrent diffusion over motion segments: a flow along time, diffusion along noise, sampled as a staircase."""
