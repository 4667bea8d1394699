"""The tuning page: vision settings tried on pictures, and written back to the configuration's file."""
