"""One page on a receiver of a dataset: `soundspaces-sim report --receiver` writes it."""

from soundspaces_receiver_page.page import write_receiver_report

__all__ = ["write_receiver_report"]
