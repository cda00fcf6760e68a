"""The one loop: Tangent -> step -> event -> cross -> orthonormalise -> collect, what prepares it and what drives it."""
