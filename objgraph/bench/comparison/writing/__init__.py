"""What is written of any comparison: tables, intervals, published figures."""
