"""Tables: any file to columns with lines, units and clocks, for campaigns and raw logs alike.

Enter: paths of files, and what their reader must be told (a table, columns, how a text is written).
Leave: columns of numbers and texts that know file, line and unit; columns of stamps as times.
"""
