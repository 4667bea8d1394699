"""The register map: rows, words, bits, and the image of a bay's state. Pure."""
