"""Figures, films and documents from arrays: what draws them knows no experiment."""
