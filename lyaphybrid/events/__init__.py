"""Events of a hybrid system: the guards of each mode, roots within a step, saltation matrices."""
