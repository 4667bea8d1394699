"""The compiled loops of the vision: one library for all of them, built where there is a C compiler."""
