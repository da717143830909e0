"""The job behind `make rirs`: plan, tiles, finish, and the engines that run them."""
