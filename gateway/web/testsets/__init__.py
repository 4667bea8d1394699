"""Test sets: labelled pictures of a bay's camera that are kept by name, and scored before settings go live."""
