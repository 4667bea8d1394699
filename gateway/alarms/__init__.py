"""Alarms after ISA-18.2 / IEC 62682: how one lives (`states`), what each means (`table`), all of them (`board`)."""
