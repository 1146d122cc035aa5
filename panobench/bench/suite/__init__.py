"""Many runs: suite files, cells, the store they end in, and the processes and machines they run on."""
