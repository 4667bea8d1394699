"""The technician's workbench: vision settings tried on pictures, and written back to the configuration's file."""
