"""Every writing command with its n-th system call failing, or killed there."""
