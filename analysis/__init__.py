"""What a run showed: the multi-seed study, its statistics, tables and figures; it comes with a later release."""
