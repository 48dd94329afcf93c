"""Named physical effects that a model may lack."""
