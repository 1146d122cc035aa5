"""What a path holds, told and shown: for `panobench probe`, `panobench view` and runs given `--root` alone."""
