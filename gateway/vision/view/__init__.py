"""Pictures for people: overlays, figures, drawings."""
