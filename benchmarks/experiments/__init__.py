"""Why figures are what they are: parts taken apart, inputs varied."""
