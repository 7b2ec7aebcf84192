"""An oracle for what names missing effects: a generator, and whoever knows how it draws."""
