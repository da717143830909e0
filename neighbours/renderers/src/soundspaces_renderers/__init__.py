"""Further renderers: without steps between bands, and of ends that move; dry sounds to try them with."""
