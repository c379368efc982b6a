"""Many runs: plan, launch, status, checks."""
