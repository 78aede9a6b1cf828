"""Result folders, fields for ParaView, tables and pictures."""
