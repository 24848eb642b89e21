"""Evaluation: how an agent does on lanes that no training has seen (paper, section IV-D)."""
