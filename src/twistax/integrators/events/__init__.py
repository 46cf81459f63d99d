"""Events: conditions along an integration, and the search for their roots."""

from .conditions import AtStart, Event
