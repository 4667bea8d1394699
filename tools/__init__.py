"""What writes the generated parts of docs/, and the firmware's header, from the tables of the package; docs/generate.py
puts them into place. No command of the gateway needs any of it.
"""
