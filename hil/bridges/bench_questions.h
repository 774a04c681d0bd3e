// Reads questions of `palpate bench public` and writes answers: CSV files, see docs/formats.md. Header only.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <functional>
#include <map>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

namespace questions {

struct Vec3 {
    double x = 0, y = 0, z = 0;
};

inline std::vector<std::string> cells(const std::string &line)
{
    std::vector<std::string> found;
    std::string cell;
    std::istringstream stream(line);
    while (std::getline(stream, cell, ',')) {
        cell.erase(std::remove(cell.begin(), cell.end(), '\r'), cell.end());
        found.push_back(cell);
    }
    return found;
}

// A CSV file with a header; cells by the names of their columns.
class Table {
public:
    explicit Table(const std::string &path) : path_(path)
    {
        std::ifstream file(path);
        std::string line;
        if (!std::getline(file, line)) throw std::runtime_error(path + ": cannot be read; write it with palpate bench public --questions");
        std::vector<std::string> header = cells(line);
        for (size_t n = 0; n < header.size(); ++n) columns_[header[n]] = n;
        while (std::getline(file, line)) rows_.push_back(cells(line));
    }
    size_t size() const { return rows_.size(); }
    bool has(const std::string &column) const { return columns_.count(column) != 0; }
    const std::string &text(size_t row, const std::string &column) const
    {
        auto found = columns_.find(column);
        if (found == columns_.end() || found->second >= rows_[row].size()) throw std::runtime_error(path_ + ": no column " + column);
        return rows_[row][found->second];
    }
    double number(size_t row, const std::string &column) const { return std::atof(text(row, column).c_str()); }
    Vec3 vector(size_t row, const std::string &x, const std::string &y, const std::string &z) const
    {
        return {number(row, x), number(row, y), number(row, z)};
    }

private:
    std::string path_;
    std::map<std::string, size_t> columns_;
    std::vector<std::vector<std::string>> rows_;
};

// A question: where the tool is, and whether it begins a new way or stands for itself.
struct Question {
    Vec3 displacement_m;
    bool begins = false;
    // A single position, which a system may answer with its equilibrium.
    bool alone = false;
};

// One file of questions, and the file of its answers. The answers keep the order of the questions.
class Sheet {
public:
    Sheet(const std::string &folder, const std::string &name) : name_(name), table_(folder + "/" + name)
    {
        bool alone = table_.has("position");
        keys_ = alone ? std::vector<std::string>{"position"} : std::vector<std::string>{"way", "tick"};
        for (size_t row = 0; row < table_.size(); ++row) {
            bool begins = alone || row == 0 || table_.text(row, "way") != table_.text(row - 1, "way");
            asked_.push_back({table_.vector(row, "dx_m", "dy_m", "dz_m"), begins, alone});
        }
        forces_.resize(asked_.size());
    }
    const std::vector<Question> &asked() const { return asked_; }
    // The force of the tool on the body, N.
    void answer(size_t number, const Vec3 &force_n) { forces_[number] = force_n; }
    // Writes the answers into an existing folder; false if it cannot.
    bool write(const std::string &folder) const
    {
        std::FILE *file = std::fopen((folder + "/" + name_).c_str(), "w");
        if (file == nullptr) return false;
        for (const std::string &key : keys_) std::fprintf(file, "%s,", key.c_str());
        std::fprintf(file, "fx_n,fy_n,fz_n\n");
        for (size_t row = 0; row < forces_.size(); ++row) {
            for (const std::string &key : keys_) std::fprintf(file, "%s,", table_.text(row, key).c_str());
            const Vec3 &f = forces_[row];
            std::fprintf(file, "%.9g,%.9g,%.9g\n", f.x, f.y, f.z);
        }
        return std::fclose(file) == 0;
    }

private:
    std::string name_;
    Table table_;
    std::vector<std::string> keys_;
    std::vector<Question> asked_;
    std::vector<Vec3> forces_;
};

} // namespace questions
