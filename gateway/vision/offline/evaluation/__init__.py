"""How well a detection method does on pictures whose truth is known: labels, verdicts, figures, report."""
