"""Events of a hybrid system: guards of a mode, roots in a step, saltation matrices."""
