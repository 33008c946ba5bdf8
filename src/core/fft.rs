//! Convolves real images by fast Fourier transforms.
