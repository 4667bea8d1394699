"""Alarms after ISA-18.2 / IEC 62682: the states of one (`states`), the definition of each (`table`), all of them
(`engine`), and the task that evaluates them (`monitor`)."""
