// A stand-in for the parts of CHAI3D's module GEL that the bridges call: members and meaning of its particle and spring.
#pragma once

#include "chai3d.h"

class cGELMassParticle {
public:
    void setMass(double a_mass) { m_mass = a_mass; }
    void addForce(chai3d::cVector3d &f) { m_force = plus(m_force, f, 1); }
    void clearForces() { m_force = chai3d::cVector3d(); }
    void computeNextPose(double a_timeInterval)
    {
        m_nextPos = m_pos;
        if (m_fixed) return;
        chai3d::cVector3d damped = plus(m_force, m_vel, -m_kDampingPos * m_mass);
        m_vel = plus(m_vel, damped, a_timeInterval / m_mass);
        m_nextPos = plus(m_pos, m_vel, a_timeInterval);
    }
    void applyNextPose() { m_pos = m_nextPos; }

    double m_mass = 0.1, m_kDampingPos = 0;
    bool m_fixed = false, m_useGravity = true;
    chai3d::cVector3d m_pos, m_nextPos, m_vel, m_force;

    static chai3d::cVector3d plus(const chai3d::cVector3d &a, const chai3d::cVector3d &b, double by)
    {
        return chai3d::cVector3d(a.x() + by * b.x(), a.y() + by * b.y(), a.z() + by * b.z());
    }
};

class cGELLinearSpring {
public:
    cGELLinearSpring(cGELMassParticle *a_node0, cGELMassParticle *a_node1) : m_node0(a_node0), m_node1(a_node1) {}
    void computeForces()
    {
        chai3d::cVector3d along = cGELMassParticle::plus(m_node1->m_pos, m_node0->m_pos, -1);
        double length = std::sqrt(along.x() * along.x() + along.y() * along.y() + along.z() * along.z());
        if (length < 0.000001) return;
        double f = m_kSpringElongation * (length - m_length0) / length;
        chai3d::cVector3d force(f * along.x(), f * along.y(), f * along.z()), back(-force.x(), -force.y(), -force.z());
        m_node0->addForce(force);
        m_node1->addForce(back);
    }
    cGELMassParticle *m_node0, *m_node1;
    double m_kSpringElongation = 100, m_length0 = 0;
};
