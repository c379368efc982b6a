"""What a run showed: the multi-seed study, its statistics, tables and figures."""
