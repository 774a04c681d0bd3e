// A stand-in for the parts of SOFA's types that the bridge uses; signatures only, with plain bodies.
#pragma once

#include <array>

using SReal = double;
#define SOFA_EXPORT_DYNAMIC_LIBRARY

namespace sofa::type {

template <int N, class Real> struct Vec : std::array<Real, N> {
    Vec() : std::array<Real, N>{} {}
    Vec(Real x, Real y, Real z) : std::array<Real, N>{x, y, z} {}
};

template <class Real> class Quat {
public:
    Quat(Real x = 0, Real y = 0, Real z = 0, Real w = 1) : x_(x), y_(y), z_(z), w_(w) {}
    Vec<3, Real> rotate(const Vec<3, Real> &v) const { return turned(v, w_); }
    Vec<3, Real> inverseRotate(const Vec<3, Real> &v) const { return turned(v, -w_); }

private:
    // v + 2 q x (q x v + w v)
    Vec<3, Real> turned(const Vec<3, Real> &v, Real w) const
    {
        auto cross = [this](const Vec<3, Real> &a) {
            return Vec<3, Real>(y_ * a[2] - z_ * a[1], z_ * a[0] - x_ * a[2], x_ * a[1] - y_ * a[0]);
        };
        Vec<3, Real> once = cross(v);
        for (int i = 0; i < 3; ++i) once[i] += w * v[i];
        Vec<3, Real> twice = cross(once);
        return Vec<3, Real>(v[0] + 2 * twice[0], v[1] + 2 * twice[1], v[2] + 2 * twice[2]);
    }
    Real x_, y_, z_, w_;
};

template <class TReal> class SpatialVector {
public:
    using Vec = sofa::type::Vec<3, TReal>;
    void clear() { line_ = free_ = Vec(); }
    const Vec &getForce() const { return line_; }
    const Vec &getTorque() const { return free_; }
    void setForce(const Vec &v) { line_ = v; }
    void setTorque(const Vec &v) { free_ = v; }

private:
    Vec line_, free_;
};

template <class TReal> class Transform {
public:
    using Vec = sofa::type::Vec<3, TReal>;
    using Rot = Quat<TReal>;
    Transform() = default;
    Transform(const Vec &origin, const Rot &orientation) : origin_(origin), orientation_(orientation) {}
    static Transform identity() { return Transform(); }
    Vec getOrigin() const { return origin_; }
    const Rot &getOrientation() const { return orientation_; }
    Vec projectVector(const Vec &child) const { return orientation_.rotate(child); }
    Vec backProjectPoint(const Vec &parent) const
    {
        return orientation_.inverseRotate(Vec(parent[0] - origin_[0], parent[1] - origin_[1], parent[2] - origin_[2]));
    }

private:
    Vec origin_;
    Rot orientation_;
};

} // namespace sofa::type
