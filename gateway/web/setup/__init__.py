"""The configuration in the browser: devices found and tried, settings previewed, saved, put in force by a restart."""
