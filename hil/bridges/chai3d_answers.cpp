// Answers the questions of `palpate bench public` about a body whose node is held, with the mass-spring model of
// CHAI3D's module GEL: a particle for each node, a spring for each edge.
//
//     chai3d_answers [--young PA] [--damping PER_S] QUESTIONS/point ANSWERS/point
//
// The stiffness of an edge is E V / L^2, with the volume V of its tetrahedra and its length L (Van Gelder 1998). A
// position is answered after the body has come to rest; along a way the model has one millisecond a sample, as in
// a haptic loop. Writes positions.csv, loops.csv, hands.csv, and system.toml with its times beside the folder.
// With the flags of CHAI3D's own build and of its module GEL in $CHAI3D:
//
//     c++ -std=c++17 -O2 -I hil/bridges hil/bridges/chai3d_answers.cpp $CHAI3D -o chai3d_answers
#include <array>
#include <chrono>
#include <memory>
#include <utility>

#include "GEL3D.h"
#include "bench_questions.h"
#include "chai3d.h"

using chai3d::cVector3d;
using questions::Vec3;

namespace {

const double TICK_S = 1e-3, DENSITY_KG_M3 = 1000, STILL_N = 1e-5;
const int MOST_STEPS = 50000;

double distance(const Vec3 &a, const Vec3 &b) { return std::sqrt(std::pow(a.x - b.x, 2) + std::pow(a.y - b.y, 2) + std::pow(a.z - b.z, 2)); }

double volume(const Vec3 &a, const Vec3 &b, const Vec3 &c, const Vec3 &d)
{
    const double u[3] = {b.x - a.x, b.y - a.y, b.z - a.z}, v[3] = {c.x - a.x, c.y - a.y, c.z - a.z}, w[3] = {d.x - a.x, d.y - a.y, d.z - a.z};
    return std::fabs(u[0] * (v[1] * w[2] - v[2] * w[1]) - u[1] * (v[0] * w[2] - v[2] * w[0]) + u[2] * (v[0] * w[1] - v[1] * w[0])) / 6;
}

// The body of a folder of questions as particles and springs.
class Body {
public:
    Body(const std::string &folder, double young_pa, double damping_per_s)
    {
        questions::Table nodes(folder + "/nodes.csv"), tets(folder + "/tets.csv"), place(folder + "/place.csv");
        std::vector<double> mass_kg(nodes.size(), 0), stiffness(nodes.size(), 0);
        for (size_t node = 0; node < nodes.size(); ++node) rest_.push_back(nodes.vector(node, "x_m", "y_m", "z_m"));
        std::map<std::pair<size_t, size_t>, double> around_m3;
        for (size_t tet = 0; tet < tets.size(); ++tet) {
            std::array<size_t, 4> corners;
            const char *const names[4] = {"a", "b", "c", "d"};
            for (int n = 0; n < 4; ++n) corners[n] = static_cast<size_t>(tets.number(tet, names[n]));
            double m3 = volume(rest_.at(corners[0]), rest_.at(corners[1]), rest_.at(corners[2]), rest_.at(corners[3]));
            for (int i = 0; i < 4; ++i) {
                mass_kg[corners[i]] += DENSITY_KG_M3 * m3 / 4;
                for (int j = 0; j < i; ++j) around_m3[std::minmax(corners[i], corners[j])] += m3;
            }
        }
        for (size_t node = 0; node < nodes.size(); ++node) {
            particles_.push_back(std::make_unique<cGELMassParticle>());
            cGELMassParticle &particle = *particles_.back();
            particle.setMass(mass_kg[node]);
            particle.m_useGravity = false;
            particle.m_kDampingPos = damping_per_s;
            particle.m_fixed = nodes.number(node, "fixed") != 0 || mass_kg[node] == 0;
        }
        touched_ = static_cast<size_t>(place.number(0, "node"));
        particles_.at(touched_)->m_fixed = true;
        restart();
        for (const auto &[ends, m3] : around_m3) {
            auto spring = std::make_unique<cGELLinearSpring>(particles_[ends.first].get(), particles_[ends.second].get());
            spring->m_length0 = distance(rest_[ends.first], rest_[ends.second]);
            spring->m_kSpringElongation = young_pa * m3 / (spring->m_length0 * spring->m_length0);
            stiffness[ends.first] += spring->m_kSpringElongation;
            stiffness[ends.second] += spring->m_kSpringElongation;
            springs_.push_back(std::move(spring));
        }
        // Explicit steps are stable well below 2 / omega of the stiffest particle.
        double step_s = TICK_S;
        for (size_t node = 0; node < nodes.size(); ++node) {
            if (!particles_[node]->m_fixed && stiffness[node] > 0) step_s = std::min(step_s, 0.5 * std::sqrt(mass_kg[node] / stiffness[node]));
        }
        steps_ = static_cast<int>(std::ceil(TICK_S / step_s));
    }

    // Back to rest.
    void restart()
    {
        for (size_t node = 0; node < particles_.size(); ++node) {
            particles_[node]->m_pos = cVector3d(rest_[node].x, rest_[node].y, rest_[node].z);
            particles_[node]->m_vel = cVector3d(0, 0, 0);
        }
    }

    // Moves the touched node, and lets the body follow for a millisecond or until it is at rest. Returns the force of
    // the tool on the body.
    Vec3 force(const questions::Question &asked)
    {
        if (asked.begins) restart();
        const Vec3 &at = rest_[touched_], &d = asked.displacement_m;
        particles_[touched_]->m_pos = cVector3d(at.x + d.x, at.y + d.y, at.z + d.z);
        int most = asked.alone ? MOST_STEPS : steps_;
        for (int step = 0; step < most; ++step) {
            bool still = move(TICK_S / steps_);
            if (asked.alone && still) break;
        }
        forces();
        const cVector3d &springs_n = particles_[touched_]->m_force;
        return {-springs_n.x(), -springs_n.y(), -springs_n.z()};
    }

private:
    void forces()
    {
        for (auto &particle : particles_) particle->clearForces();
        for (auto &spring : springs_) spring->computeForces();
    }
    // One step; true if no free particle is pushed or moves.
    bool move(double step_s)
    {
        forces();
        bool still = true;
        for (auto &particle : particles_) {
            const cVector3d &f = particle->m_force, &v = particle->m_vel;
            double push_n = std::sqrt(f.x() * f.x() + f.y() * f.y() + f.z() * f.z());
            double speed = std::sqrt(v.x() * v.x() + v.y() * v.y() + v.z() * v.z());
            still = still && (particle->m_fixed || (push_n < STILL_N && speed < 1e-5));
            particle->computeNextPose(step_s);
        }
        for (auto &particle : particles_) particle->applyNextPose();
        return still;
    }

    std::vector<Vec3> rest_;
    std::vector<std::unique_ptr<cGELMassParticle>> particles_;
    std::vector<std::unique_ptr<cGELLinearSpring>> springs_;
    size_t touched_ = 0;
    int steps_ = 1;
};

double share(const std::vector<double> &sorted, double q) { return sorted[static_cast<size_t>(q * static_cast<double>(sorted.size() - 1))]; }

int run(const std::string &from, const std::string &to, double young_pa, double damping_per_s)
{
    Body body(from, young_pa, damping_per_s);
    std::vector<double> ticks_us;
    for (const char *name : {"positions.csv", "loops.csv", "hands.csv"}) {
        questions::Sheet sheet(from, name);
        for (size_t number = 0; number < sheet.asked().size(); ++number) {
            auto begun = std::chrono::steady_clock::now();
            sheet.answer(number, body.force(sheet.asked()[number]));
            std::chrono::duration<double, std::micro> spent = std::chrono::steady_clock::now() - begun;
            if (!sheet.asked()[number].alone) ticks_us.push_back(spent.count());
        }
        if (!sheet.write(to)) throw std::runtime_error(to + "/" + name + ": cannot be written; make the folder first");
        std::fprintf(stderr, "chai3d_answers: %s: %zu answers\n", name, sheet.asked().size());
    }
    std::FILE *file = std::fopen((to + "/../system.toml").c_str(), "w");
    if (file == nullptr) throw std::runtime_error(to + "/../system.toml: cannot be written");
    std::fprintf(file, "about = \"CHAI3D, module GEL: mass-spring model, E = %g Pa, damping %g 1/s\"\n", young_pa, damping_per_s);
    std::sort(ticks_us.begin(), ticks_us.end());
    if (!ticks_us.empty()) {
        std::fprintf(file, "\n[figures.\"tick.point\"]\np50_us = %.4f\np99_us = %.4f\np9999_us = %.4f\nmax_us = %.4f\n",
                     share(ticks_us, 0.5), share(ticks_us, 0.99), share(ticks_us, 0.9999), ticks_us.back());
    }
    return std::fclose(file);
}

} // namespace

int main(int argc, char **argv)
{
    // Three times the shear modulus of the bundled organ.
    double young_pa = 15480, damping_per_s = 20;
    std::vector<std::string> folders;
    for (int i = 1; i < argc; ++i) {
        std::string word = argv[i];
        if (word == "--young" && i + 1 < argc) young_pa = std::atof(argv[++i]);
        else if (word == "--damping" && i + 1 < argc) damping_per_s = std::atof(argv[++i]);
        else folders.push_back(word);
    }
    if (folders.size() != 2 || !(young_pa > 0 && damping_per_s >= 0)) {
        std::fprintf(stderr, "usage: chai3d_answers [--young PA] [--damping PER_S] QUESTIONS/point ANSWERS/point\n");
        return 2;
    }
    try {
        return run(folders[0], folders[1], young_pa, damping_per_s);
    } catch (const std::exception &error) {
        std::fprintf(stderr, "chai3d_answers: %s\n", error.what());
        return 1;
    }
}
